// How everything is, in words and numbers.
import type { Library } from "../library/library";
import type { BatteryModel, ClockModel, RobotModel, SlamModel } from "../link/messages";
import { by, make, setText, show, within } from "../ui/dom";
import { capitalised, percent } from "../ui/text";
import { Guide } from "./guide";

export class HealthView {
  private robot: RobotModel | null = null;
  private slam: SlamModel | null = null;
  private isStationOpen = false;
  private readonly guide = new Guide();

  constructor(private readonly library: Library) {}

  showRobot(robot: RobotModel): void {
    this.robot = robot;
    show(by("battery"), robot.battery !== null);
    if (robot.battery) setText(by("battery"), describe(robot.battery));
    this.draw();
  }

  showSlam(slam: SlamModel): void {
    this.slam = slam;
    this.draw();
  }

  setStation(open: boolean): void {
    this.isStationOpen = open;
    this.draw();
  }

  draw(): void {
    const robot = this.robot;
    const link = by("link");
    link.dataset.state = !this.isStationOpen ? "bad" : robot?.connected ? "good" : "warn";
    setText(
      within(link, ".text"),
      !this.isStationOpen ? "station does not answer" : robot?.connected ? (robot.name ?? "robot") : "no robot",
    );
    this.guide.show(robot, this.library);
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
      ["Network", capitalised(robot.network.sentence), robot.network.grade !== "good"],
      [
        "Video",
        `${robot.rates.frames_hz.toFixed(0)} /s · ${robot.losses.frames_skipped} skipped`,
        robot.connected && robot.rates.frames_hz < 10,
      ],
      ["IMU", `${robot.rates.imu_hz.toFixed(0)} /s · ${robot.losses.imu_lost} lost`, robot.losses.imu_lost > 0],
      ["Data", `${((robot.rates.bytes_per_s * 8) / 1e6).toFixed(1)} Mbit/s`, false],
      ["Clock", describeClock(robot.clock), false],
      [
        "Robot CPU",
        robot.cpu_percent === null ? "–" : `${robot.cpu_percent.toFixed(0)} % of a core`,
        (robot.cpu_percent ?? 0) > 90,
      ],
      ["SLAM", this.slam?.message ?? "–", this.slam?.state === "lost"],
    ];
    const fit = robot.calibration_fit;
    if (fit) rows.push(["Calibration", capitalised(fit.sentence), fit.verdict === "does not fit"]);
    for (const [sensor, celsius] of Object.entries(robot.temperatures_c))
      rows.push([sensor, `${celsius.toFixed(0)} °C`, celsius > 80]);
    for (const fault of robot.faults) rows.push(["Fault", fault, true]);
    by("health").replaceChildren(
      ...rows.flatMap(([name, text, bad]) => [make("dt", {}, name), make("dd", { class: bad ? "bad" : "" }, text)]),
    );
  }
}

function describe({ voltage_v, fraction }: BatteryModel): string {
  const voltage = voltage_v === null ? [] : [`${voltage_v.toFixed(1)} V`];
  return [...voltage, ...(fraction === null ? [] : [percent(fraction)])].join(" · ");
}

function describeClock({ bound_ms, drift_ppm }: ClockModel): string {
  if (bound_ms === null || drift_ppm === null) return "not known yet";
  return `known within ${bound_ms.toFixed(1)} ms · drift ${drift_ppm.toFixed(0)} ppm`;
}
