// How everything is, in words and numbers, and what to do first.
import type { Library } from "../library/library";
import type { LogModel, RobotModel, SlamModel } from "../link/messages";
import { by, make, prose, setText, show, within } from "../ui/dom";
import { clock, percent } from "../ui/text";

const MAX_LINES = 100;

export class HealthView {
  private robot: RobotModel | null = null;
  private slam: SlamModel | null = null;
  private lines = new Map<number, LogModel>(); // by their number, newest first
  private guideText = "";
  stationOpen = false;

  constructor(private readonly library: Library) {}

  showRobot(robot: RobotModel): void {
    this.robot = robot;
    show(by("battery"), robot.battery !== null);
    if (robot.battery)
      setText(
        by("battery"),
        `${robot.battery.voltage_v?.toFixed(1)} V` +
          (robot.battery.fraction === null ? "" : ` · ${percent(robot.battery.fraction)}`),
      );
    this.draw();
  }

  showSlam(slam: SlamModel): void {
    this.slam = slam;
    this.draw();
  }

  setStation(open: boolean): void {
    this.stationOpen = open;
    this.draw();
  }

  /** New lines, or old ones; a line that is shown already is not shown twice. */
  addLines(lines: LogModel[]): void {
    for (const line of lines) this.lines.set(line.number, line);
    const newest = [...this.lines.values()].sort((a, b) => b.number - a.number).slice(0, MAX_LINES);
    this.lines = new Map(newest.map((line) => [line.number, line]));
    const log = by("log");
    const shown = new Map([...log.children].map((item) => [Number((item as HTMLElement).dataset.number), item]));
    for (const [number, item] of shown) if (!this.lines.has(number)) item.remove();
    let before: Element | null = null; // the log is a live region: only what is new may be added to it
    for (const line of newest.reverse()) {
      const item: Element = shown.get(line.number) ?? logItem(line);
      if (!item.isConnected) log.insertBefore(item, before ?? null);
      before = item;
    }
  }

  /** Another station's lines, or the same one's since its start, are counted from 1 again. */
  clearLog(): void {
    this.lines.clear();
    by("log").replaceChildren();
  }

  draw(): void {
    const robot = this.robot;
    const link = by("link");
    link.dataset.state = !this.stationOpen ? "bad" : robot?.connected ? "good" : "warn";
    setText(
      within(link, ".text"),
      !this.stationOpen ? "station does not answer" : robot?.connected ? (robot.name ?? "robot") : "no robot",
    );
    this.drawGuide();
    if (!robot) return;
    const rows: [string, string, boolean][] = [
      [
        "Link",
        robot.connected
          ? robot.clock.rtt_ms === null
            ? "connected"
            : `${robot.clock.rtt_ms.toFixed(1)} ms round trip`
          : robot.reason,
        !robot.connected,
      ],
      [
        "Video",
        `${robot.rates.frames_hz.toFixed(0)} /s · ${robot.losses.frames_skipped} skipped`,
        robot.connected && robot.rates.frames_hz < 10,
      ],
      ["IMU", `${robot.rates.imu_hz.toFixed(0)} /s · ${robot.losses.imu_lost} lost`, robot.losses.imu_lost > 0],
      ["Data", `${((robot.rates.bytes_per_s * 8) / 1e6).toFixed(1)} Mbit/s`, false],
      [
        "Clock",
        robot.clock.drift_ppm === null ? "not known yet" : `drift ${robot.clock.drift_ppm.toFixed(0)} ppm`,
        false,
      ],
      [
        "Robot CPU",
        robot.cpu_percent === null ? "–" : `${robot.cpu_percent.toFixed(0)} % of a core`,
        (robot.cpu_percent ?? 0) > 90,
      ],
      ["SLAM", this.slam?.message ?? "–", this.slam?.state === "lost"],
    ];
    for (const [sensor, celsius] of Object.entries(robot.temperatures_c))
      rows.push([sensor, `${celsius.toFixed(0)} °C`, celsius > 80]);
    for (const fault of robot.faults) rows.push(["Fault", fault, true]);
    by("health").replaceChildren(
      ...rows.flatMap(([name, text, bad]) => [make("dt", {}, name), make("dd", { class: bad ? "bad" : "" }, text)]),
    );
  }

  private drawGuide(): void {
    const navigations = [...this.library.navigations.values()];
    const hasNavigation = navigations.some((n) => n.state === "ready");
    const recordHow = this.library.recording
      ? "Drive slowly through every room, look around, and come back. Then press Stop recording."
      : navigations.some((n) => n.state === "finishing")
        ? "The recording has ended, and SLAM finishes it: below you see how far it is."
        : "Press Record, drive slowly through every room, look around, and come back. Then stop.";
    const hasMap = this.library.maps.length > 0;
    const isUsed = this.library.maps.some((m) => m.active);
    const robot = this.robot;
    const elsewhere = "(elsewhere: `station serve --robot HOST:PORT`, or `--robot auto` to search the network)";
    const where = !robot
      ? ""
      : robot.host === "auto"
        ? "; this station looks in the whole network"
        : `; this station looks at ${robot.host}:${robot.port} ${elsewhere}`;
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
    const next = steps.findIndex(([done]) => !done);
    const text = JSON.stringify([steps, next]);
    if (text === this.guideText) return;
    this.guideText = text;
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

function logItem(line: LogModel): HTMLElement {
  const item = make("li", { class: line.level }, make("time", {}, clock(line.unix_s)), line.text);
  item.dataset.topic = line.topic;
  item.dataset.number = String(line.number);
  return item;
}
