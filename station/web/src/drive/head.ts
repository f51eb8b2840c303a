// Sliders that point the camera head.
import type { RobotModel } from "../link/messages";
import { by, show } from "../ui/dom";

export class HeadControl {
  private readonly pan = by("pan", HTMLInputElement);
  private readonly tilt = by("tilt", HTMLInputElement);
  private readonly ahead = by("head-ahead", HTMLButtonElement);

  /** `point`: rad, left and up. */
  constructor(private readonly point: (pan: number, tilt: number) => void) {
    for (const slider of [this.pan, this.tilt]) slider.addEventListener("input", () => this.send());
    this.ahead.addEventListener("click", () => {
      this.lookAhead();
      this.send();
    });
  }

  show(robot: RobotModel): void {
    const mustRest = robot.head_must_rest !== "";
    const head = by("head");
    show(head, Boolean(robot.connected && robot.capabilities?.pan_tilt));
    head.title = robot.head_must_rest;
    for (const control of [this.pan, this.tilt, this.ahead]) control.disabled = mustRest;
    if (mustRest) this.lookAhead();
  }

  private lookAhead(): void {
    for (const slider of [this.pan, this.tilt]) slider.value = "0";
  }

  private send(): void {
    const angle = (slider: HTMLInputElement) => (Number(slider.value) * Math.PI) / 180;
    this.point(-angle(this.pan), angle(this.tilt));
  }
}
