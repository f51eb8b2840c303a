// Which of the station's robots this page shows: `?robot=NAME` in its address, the first one without.
import type { RobotEntry } from "./messages";

const chosen = new URLSearchParams(location.search).get("robot");
// The calls that concern one robot (OF_ROBOT in station/api/roles.py).
const OF_ROBOT =
  /^\/(robot(\/hijack|\/pair)?|stop|drive(\/.*)?|pan-tilt|ws\/(drive|camera|events)|camera\/.*|log|pose|trajectory|landmarks|place\/.*)(\?.*)?$/;

let shown = chosen;

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
  select.replaceChildren(
    ...robots.map((entry) => {
      const title = entry.robot.name && entry.robot.name !== entry.name ? `${entry.name} (${entry.robot.name})` : entry.name;
      return new Option(title, entry.name, false, entry.name === shown);
    }),
  );
  select.hidden = robots.length < 2;
  select.onchange = () => location.assign(`?robot=${encodeURIComponent(select.value)}`);
}
