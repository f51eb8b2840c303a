// What to do first, step by step, until the page can say where the robot is.
import type { Library } from "../library/library";
import type { RobotModel } from "../link/messages";
import { by, make, prose, show } from "../ui/dom";
import { capitalised } from "../ui/text";

export class Guide {
  private shown = "";

  /** Say how far one is with this robot and this library. */
  show(robot: RobotModel | null, library: Library): void {
    const navigations = [...library.navigations.values()];
    const hasNavigation = navigations.some((n) => n.state === "ready");
    const recordHow = library.recording
      ? "Drive slowly round every room, once to the left and once to the right, and come back. Then press Stop recording."
      : navigations.some((n) => n.state === "finishing")
        ? "The recording has ended, and SLAM finishes it: below you see how far it is."
        : "Press Record, drive slowly round every room, once to the left and once to the right, and come back. Then stop.";
    const hasMap = library.maps.length > 0;
    const isUsed = library.maps.some((m) => m.active);
    const elsewhere = "(elsewhere: `station serve --robot HOST:PORT`, or `--robot auto` to search the network)";
    const host = robot?.host.includes(":") ? `[${robot.host}]` : (robot?.host ?? ""); // IPv6
    const where = !robot
      ? ""
      : robot.host === "auto"
        ? "; this station looks in the whole network"
        : `; this station looks at ${host}:${robot.port} ${elsewhere}`;
    const steps: [boolean, string, string][] = [
      [
        Boolean(robot?.connected),
        "Connect a robot",
        `Start \`robot-server\` on it${where}. No robot at hand? \`robot-server --devices simulated\` on this computer drives in a simulated flat.`,
      ],
      [hasNavigation || hasMap, "Record a navigation", recordHow],
      [hasMap, "Build a map", "Press Build map beside the navigation: its landmarks become places."],
      [isUsed, "Ask where it is", "Choose the map, pick the robot up, put it down anywhere: the page names the place."],
    ];
    if (robot?.connected && !robot.calibrated)
      steps.splice(1, 0, [false, "Calibrate the camera", "This robot's camera is not calibrated; SLAM needs it."]);
    if (robot?.connected && robot.calibration_fit?.verdict === "does not fit")
      steps.splice(1, 0, [false, "Calibrate the camera", capitalised(robot.calibration_fit.sentence)]);
    const next = steps.findIndex(([done]) => !done);
    const text = JSON.stringify([steps, next]);
    if (text === this.shown) return;
    this.shown = text;
    show(by("guide"), next >= 0);
    by("guide").replaceChildren(
      make("h2", {}, "First steps"),
      make(
        "ol",
        {},
        ...steps.map(([done, title, how], i) =>
          make(
            "li",
            { class: done ? "done" : i === next ? "next" : "" },
            make("strong", {}, title),
            i === next && make("p", { class: "note" }, ...prose(how)),
          ),
        ),
      ),
    );
  }
}
