// The page: parts that show, one event stream that tells them.
import "./style.css";
import { call, LastingSocket } from "./api";
import { ask, attempt, by, show } from "./dom";
import { DriveControl } from "./drive";
import { HealthView } from "./health";
import { Library } from "./library";
import { MapView } from "./map3d";
import type { EventMessage, LogModel } from "./messages";
import { openPlace, PlaceView } from "./place";
import { VideoView } from "./video";

const video = new VideoView();
const drive = new DriveControl(video);
const library = new Library();
const health = new HealthView(library);
const places = new PlaceView();
const map = makeMap();

/** Without WebGL everything but the 3D view works. */
function makeMap(): MapView | null {
  try {
    return new MapView(video.canvas);
  } catch {
    by("scene-empty").textContent = "This browser shows no 3D graphics (WebGL is off).";
    return null;
  }
}

if (map) map.onPlace = openPlace;
library.onChange = () => health.draw();

async function showMap(active: string | null): Promise<void> {
  await map?.showMap(active);
  places.setGraph(map?.graph ?? null);
  await library.reloadMaps();
}

function take(message: EventMessage): void {
  switch (message.type) {
    case "robot":
      drive.show(message.robot);
      drive.showDriver(message.robot.driver);
      health.showRobot(message.robot);
      library.setConnected(message.robot.connected);
      show(by("hijack"), Boolean(message.robot.connected && message.robot.capabilities?.hijack));
      break;
    case "driver":
      drive.showDriver(message.driver);
      break;
    case "pose":
      map?.showSlam(message.slam);
      health.showSlam(message.slam);
      library.showSlam(message.slam);
      break;
    case "landmarks":
      if (message.total) map?.suggest("live");
      if (map) attempt(() => map.updateLive(message.navigation, message.total));
      break;
    case "navigation":
      if (message.navigation) library.update(message.navigation);
      else attempt(() => library.reload());
      break;
    case "map":
      if (message.active) map?.suggest("map");
      attempt(() => showMap(message.active));
      break;
    case "job":
      library.updateJob(message.job);
      break;
    case "place":
      places.show(message.place, message.visit);
      map?.showPlace(message.place);
      break;
    case "log":
      health.addLine(message.line);
      break;
  }
}

new LastingSocket(
  "/ws/events",
  (data) => take(JSON.parse(data as string) as EventMessage),
  (open) => {
    health.setStation(open);
    if (open) attempt(load);
  },
);

/** The state that events only change: after opening the page, and after the station was away. */
async function load(): Promise<void> {
  const lines = await call<LogModel[]>("GET", "/log");
  health.clearLog();
  lines.forEach((line) => health.addLine(line));
  await library.reload();
  take({ type: "robot", robot: await call("GET", "/robot") });
  take({ type: "pose", slam: await call("GET", "/pose") });
  await showMap(library.maps.find((m) => m.active)?.id ?? null);
  take({ type: "place", place: await call("GET", "/place/current"), visit: null });
  await map?.updateLive(null, 0);
}

attempt(() => places.start());

by("hijack").addEventListener("click", () =>
  attempt(async () => {
    const where = await ask("Put the simulated robot down elsewhere", "Hijack", { label: "x y heading (m, m, degrees)", value: "1.0 1.0 90" });
    if (!where) return;
    const [x, y, degrees] = where.trim().split(/[\s,;]+/).map(Number);
    if (![x, y, degrees].every((n) => Number.isFinite(n))) throw new Error("three numbers are needed: x y heading");
    await call("POST", "/robot/hijack", { x, y, yaw: (degrees! * Math.PI) / 180 });
  }),
);

by("theme").addEventListener("click", () => {
  const dark = getComputedStyle(document.documentElement).colorScheme.includes("dark");
  setTheme(dark ? "light" : "dark");
});

function setTheme(theme: string): void {
  document.documentElement.dataset["theme"] = theme;
  localStorage.setItem("theme", theme);
}
setTheme(localStorage.getItem("theme") ?? (matchMedia("(prefers-color-scheme: light)").matches ? "light" : "dark"));
