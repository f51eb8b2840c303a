/**
 * The name this tab drives under; a reload keeps it. It is not in the store while the page is open, since a duplicated tab
 * begins with a copy of that, and two tabs of one name would be one driver: what one stops, the other could go on with.
 */
export const driverName = (() => {
  const known = sessionStorage.getItem("driver");
  sessionStorage.removeItem("driver");
  const device = matchMedia("(pointer: coarse)").matches ? "phone" : "laptop";
  const name = known ?? `${device} ${Math.floor(100 + Math.random() * 900)}`;
  addEventListener("pagehide", () => sessionStorage.setItem("driver", name));
  addEventListener("pageshow", () => sessionStorage.removeItem("driver")); // back from where browsers keep closed pages
  return name;
})();
