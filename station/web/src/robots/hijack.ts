// Pick a simulated robot up and put it down elsewhere.
import { call } from "../link/api";
import { by, make } from "../ui/dom";
import { attempt } from "../ui/toast";

const FIELDS: [string, string, string][] = [
  ["x", "x, m", "1"],
  ["y", "y, m", "1"],
  ["yaw", "heading, degrees", "90"],
];

export function openHijack(): void {
  const dialog = by("ask", HTMLDialogElement);
  const choice = (value: string, text: string, checked: boolean) => {
    const input = make("input", { type: "radio", name: "where", value, checked });
    return { input, label: make("label", { class: "choice" }, input, text) };
  };
  const anywhere = choice("anywhere", "Carry it to another room", true);
  const spot = choice("spot", "Put it down at", false);
  const inputs = FIELDS.map(([, , value]) => make("input", { type: "number", step: "any", required: true, value }));
  const refresh = () => inputs.forEach((input) => (input.disabled = !spot.input.checked));
  for (const { input } of [anywhere, spot]) input.addEventListener("change", refresh);
  refresh();
  const [x, y, degrees] = inputs.map((input) => () => Number(input.value)) as [
    () => number,
    () => number,
    () => number,
  ];
  const form = make(
    "form",
    { method: "dialog" },
    make("h2", {}, "Pick the simulated robot up"),
    anywhere.label,
    spot.label,
    make("div", { class: "fields" }, ...FIELDS.map(([, label], i) => make("label", {}, label, inputs[i]))),
    make(
      "p",
      { class: "note" },
      "In the simulated world's own coordinates, which no map knows. Only free floor is taken.",
    ),
    make(
      "div",
      { class: "row end" },
      make("button", { type: "button", class: "quiet", onclick: () => dialog.close("") }, "Cancel"),
      make("button", { type: "submit", class: "primary", value: "yes" }, "Hijack"),
    ),
  );
  dialog.setAttribute("aria-label", "Pick the simulated robot up");
  dialog.replaceChildren(form);
  dialog.oncancel = null;
  dialog.onclose = () => {
    if (dialog.returnValue !== "yes") return;
    const where = spot.input.checked ? { x: x(), y: y(), yaw: (degrees() * Math.PI) / 180 } : {};
    attempt(() => call("POST", "/robot/hijack", where));
  };
  dialog.returnValue = "";
  dialog.showModal();
}
