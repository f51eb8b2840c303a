// Which of the station's robots this page shows: `?robot=NAME` in its address, the first one without.
import { by, make } from "./dom";
import type { RobotEntry } from "./messages";

const chosen = new URLSearchParams(location.search).get("robot");
// The calls that concern one robot (OF_ROBOT in station/api/roles.py).
const OF_ROBOT =
  /^\/(robot(\/hijack|\/pair)?|stop|drive(\/.*)?|pan-tilt|ws\/(drive|camera|events)|camera\/.*|log|pose|trajectory|landmarks|place\/.*)(\?.*)?$/;

const NO_SUCH = "No such robot"; // the dialog's name

let shown = chosen;

/** Whether the address names a robot that this station does not have (any more): then nothing on the page would work. */
export function isGone(robots: RobotEntry[]): boolean {
  return chosen !== null && !robots.some((entry) => entry.name === chosen);
}

/** Say that there is no such robot, and which there are. */
export function offerOthers(robots: RobotEntry[]): void {
  const dialog = by<HTMLDialogElement>("ask");
  if (dialog.open && dialog.getAttribute("aria-label") === NO_SUCH) return;
  const entries = robots.map((entry) =>
    make("li", {}, make("a", { class: "small", href: `?robot=${encodeURIComponent(entry.name)}` }, titleOf(entry))),
  );
  dialog.setAttribute("aria-label", NO_SUCH);
  dialog.replaceChildren(
    make("h2", {}, `This station has no robot “${chosen}”`),
    make(
      "p",
      { class: "note" },
      `It was renamed, or left out when the station was started anew. ${robots.length === 1 ? "There is this one:" : "There are these:"}`,
    ),
    make("ul", { class: "list" }, ...entries),
  );
  dialog.oncancel = (event) => event.preventDefault(); // behind it nothing works
  dialog.onclose = null;
  if (!dialog.open) dialog.showModal();
}

/** The robot of this address is there: no other one need be chosen (any more). */
export function offerNoOthers(): void {
  const dialog = by<HTMLDialogElement>("ask");
  if (dialog.open && dialog.getAttribute("aria-label") === NO_SUCH) dialog.close("");
}

function titleOf(entry: RobotEntry): string {
  return entry.robot.name && entry.robot.name !== entry.name ? `${entry.name} (${entry.robot.name})` : entry.name;
}

/** Whether this page shows the robot of that name. */
export function isShown(robot: string): boolean {
  return shown === null || robot === shown;
}

/** The address of a call to the robot that is shown. */
export function toRobot(path: string, method = "GET"): string {
  const isOfRobot = OF_ROBOT.test(path) || (method === "POST" && path === "/navigations");
  if (chosen === null || !isOfRobot) return path;
  return `/robots/${encodeURIComponent(chosen)}${path.replace(/^\/robot(?=\/|$)/, "")}`;
}

/** Fills the list of robots; it is shown when there are several. */
export function showChoice(select: HTMLSelectElement, robots: RobotEntry[]): void {
  shown = chosen ?? robots[0]?.name ?? null;
  select.replaceChildren(...robots.map((entry) => new Option(titleOf(entry), entry.name, false, entry.name === shown)));
  select.hidden = robots.length < 2;
  select.onchange = () => location.assign(`?robot=${encodeURIComponent(select.value)}`);
}
