// What the person at the wheel reads: who drives, how fast, and why it stopped.
import type { AheadModel } from "../link/messages";
import { by, setText, show } from "../ui/dom";

const WHY_MS = 5000;
const NEAR_M = 0.5; // a second and a half at the speed that the robot has at first

export class DrivePanel {
  private readonly driver = by("driver");
  private readonly why = by("why");
  private readonly ahead = by("ahead");
  private readonly limit = by("speed", HTMLInputElement);
  private whyTimer = 0;
  private saidSeq = 0; // the command before the sentence on the screen

  constructor() {
    this.limit.addEventListener("input", () => setText(by("speed-text"), `${this.limit.value} %`));
  }

  /** The share of the robot's own speed limits, 0..1. */
  get speedLimit(): number {
    return Number(this.limit.value) / 100;
  }

  /** `text`: who drives; `other`: the one who does, when it is not the person at this page. */
  showDriver(text: string, other: string | null): void {
    setText(this.driver, text);
    this.driver.title = other === null ? "" : text;
    this.driver.classList.toggle("other", other !== null);
  }

  /** What a hand on the stick would do. */
  showInvitation(text: string): void {
    setText(this.driver, text);
  }

  showVelocity(linear: number, angular: number): void {
    setText(by("linear"), `${linear.toFixed(2)} m/s`);
    setText(by("angular"), `${angular.toFixed(2)} rad/s`);
  }

  /** How far the next thing ahead is, where the robot has a sensor for it. */
  showAhead(ahead: AheadModel | null): void {
    show(this.ahead, ahead !== null);
    if (ahead === null) return;
    setText(this.ahead, describe(ahead));
    this.ahead.dataset.near = String(ahead.distance_m !== null && ahead.distance_m < NEAR_M);
  }

  /** Say why it stopped, for a while; `seq` is the newest command before. */
  say(text: string, seq: number): void {
    this.saidSeq = seq;
    this.why.textContent = text;
    show(this.why, true);
    clearTimeout(this.whyTimer);
    this.whyTimer = window.setTimeout(() => show(this.why, false), WHY_MS);
  }

  /** A command was accepted. A newer one than the stop: it drives again, and why it stopped is past. */
  accept(seq: number): void {
    if (seq > this.saidSeq) show(this.why, false);
  }
}

function describe({ distance_m: metres, age_s }: AheadModel): string {
  if (age_s === null) return "Distance ahead unknown";
  if (metres === null) return "Nothing measured ahead";
  return `${metres < 1 ? `${Math.round(metres * 100)} cm` : `${metres.toFixed(1)} m`} to the next thing ahead`;
}
