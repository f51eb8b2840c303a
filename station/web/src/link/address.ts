// Which of the station's robots this page shows: `?robot=NAME` in its address, the first one without.
import type { RobotEntry } from "./messages";

const named = new URLSearchParams(location.search).get("robot");
// The calls that concern one robot (OF_ROBOT in station/api/roles.py).
const OF_ROBOT =
  /^\/(robot(\/hijack|\/pair)?|stop|drive(\/.*)?|pan-tilt|ws\/(drive|camera|events)|camera\/.*|calibration(\/(?!target\.pdf).*)?|log|pose|trajectory|landmarks|place\/.*)(\?.*)?$/;

let shown = named;

/** Find out which of the station's robots is shown, and say its name; null while there is none. */
export function findShown(robots: RobotEntry[]): string | null {
  shown = named ?? robots[0]?.name ?? null;
  return shown;
}

/** Whether this page shows the robot of that name. */
export function isShown(robot: string): boolean {
  return shown === null || robot === shown;
}

/** The robot that the address names though this station does not have it (any more): nothing on the page would work. */
export function findMissing(robots: RobotEntry[]): string | null {
  return robots.some((entry) => entry.name === named) ? null : named;
}

/** The address of a call to the robot that is shown. */
export function toRobot(path: string, method = "GET"): string {
  const isOfRobot = OF_ROBOT.test(path) || (method === "POST" && path === "/navigations");
  if (named === null || !isOfRobot) return path;
  return `/robots/${encodeURIComponent(named)}${path.replace(/^\/robot(?=\/|$)/, "")}`;
}

export function socketUrl(path: string): string {
  return `${location.protocol === "https:" ? "wss" : "ws"}://${location.host}${toRobot(path)}`;
}
