// When the page may drive, and when it must stop. Nothing here touches document, network or clock: the rules are read, and
// tested, by themselves.
import type { CapabilitiesModel, NetworkModel } from "../link/messages";

/** Where hands point: x right, y forward, both -1..1. */
export type Direction = readonly [x: number, y: number];

export const STALE_MS = 500; // nobody drives by an older picture
const SIGHT_MS = 250; // what is seen so late and answered so soon is driven as by sight
const REMEMBERED_MS = 1000; // the slowest second counts: a speed that follows each picture would stutter
const TELL_AFTER_MS = 1500; // a picture this old is no hiccup: the control says beforehand that it cannot drive

/** What takes hands or eyes off the robot. Each of them stops it, and says why in these words. */
export const INTERRUPTION = {
  windowLeft: "the window lost focus",
  pageHidden: "the page is hidden",
  pageClosed: "the page was closed",
  menuOpened: "a menu was opened", // it keeps to itself what is let go
  metaKey: "the Command or Windows key was pressed", // what is let go beside ⌘ is never told to a page (macOS)
  touchCancelled: "the touch was interrupted",
  pointerLost: "the pointer was lost",
  gamepadGone: "the gamepad is gone",
  stationSilent: "the station does not answer",
} as const;

/** What the page knows in the moment somebody wants to drive. */
export interface Situation {
  mayDrive: boolean; // false: this visitor may only watch
  isConnected: boolean;
  robot: Pick<CapabilitiesModel, "drive" | "camera"> | null;
  dialogIsOpen: boolean; // where the keyboard is in a dialog or a list, STOP by the space bar might not be heard
  listIsOpen: boolean;
  pictureAgeMs: number; // Infinity: none has come yet
}

/** Why the page must not drive; empty: it may. */
export function whyNotDrive(s: Situation): string {
  if (!s.mayDrive) return "your token may only watch";
  if (!s.isConnected || !s.robot) return "no robot is connected";
  if (s.dialogIsOpen) return "a dialog is open";
  if (s.listIsOpen) return "a list is being chosen from";
  if (!s.robot.camera) return "";
  if (s.pictureAgeMs === Infinity) return "no picture of the robot has come yet";
  return s.pictureAgeMs > STALE_MS ? `the picture is ${(s.pictureAgeMs / 1000).toFixed(1)} s old` : "";
}

/**
 * The share of the wanted speed that the network leaves, 0..1. What passes before the robot answers to what it met is the
 * picture's age and the command's way; the robot goes no farther in it than by sight.
 */
export function speedShare(pictureAgeMs: number, roundTripMs: number): number {
  return Math.min(1, SIGHT_MS / Math.max(1, pictureAgeMs + roundTripMs)); // clocks that jumped make an age negative
}

/** That whoever reads it drives, and what slows the robot where something does. */
export function youDrive(share: number, network: Pick<NetworkModel, "grade" | "computer_busy"> | null): string {
  if (share >= 0.9) return "You drive";
  const isSlow = network?.grade === "slow" || network?.grade === "bad";
  const way = isSlow ? "the network is slow" : "pictures come late to this page"; // they were in time at the station
  return `You drive, slowed to ${Math.round(share * 100)} %: ${network?.computer_busy ? "the station's computer is busy" : way}`;
}

/** The largest of the values of the last second. */
export class SlowestSecond {
  private values: [atMs: number, value: number][] = [];

  note(value: number, nowMs: number): number {
    this.values = [...this.values.filter(([atMs]) => nowMs - atMs <= REMEMBERED_MS), [nowMs, value]];
    return Math.max(...this.values.map(([, each]) => each));
  }
}

/** What a hand on the stick would do while nobody drives, in words. */
export function invitation(s: Situation): string {
  if (!s.isConnected) return "No robot";
  if (!s.robot?.drive) return "This robot cannot drive";
  return s.robot.camera && s.pictureAgeMs > TELL_AFTER_MS ? "No driving: the picture is old" : "Hold to drive";
}

/** Everything a person may hold to drive. */
export interface Hands {
  /** null: nothing is held */
  readonly direction: Direction | null;
  /** Forget what is held: it counts again only when it is held anew. */
  release(): void;
}

/** What the guard does to robot and page. */
export interface Wheel {
  /** False: the command did not go out. */
  drive(direction: Direction): boolean;
  stop(reason: string): void;
  say(text: string): void;
}

/** Stands between hands and robot: drives only while something is held and nothing speaks against it. */
export class DriveGuard {
  private driving = false;

  constructor(
    private readonly hands: Hands,
    private readonly wheel: Wheel,
  ) {}

  /** Whether the robot moves because of us. */
  get isDriving(): boolean {
    return this.driving;
  }

  /** At short intervals, and whenever hands change. */
  tick(situation: Situation): void {
    const direction = this.hands.direction;
    if (!direction) {
      if (this.driving) this.stop("");
      return;
    }
    const why = whyNotDrive(situation);
    if (why) this.halt(why);
    else if (this.wheel.drive(direction)) this.driving = true;
    else this.halt(INTERRUPTION.stationSilent);
  }

  /** Stop, let go of everything, and say why. It must be held anew to go on. */
  halt(reason: string): void {
    // What we have not set going may be another one's drive, and a STOP of ours would end it.
    this.letGo(reason, this.driving);
  }

  /** The station refused a command, so another one may be driving: a STOP of ours would stop that one. */
  refuse(reason: string): void {
    this.letGo(reason, false);
  }

  private letGo(reason: string, stopRobot: boolean): void {
    const wasHeld = this.driving || this.hands.direction !== null;
    this.hands.release();
    if (stopRobot) this.stop(reason);
    this.driving = false;
    if (wasHeld) this.wheel.say(`Stopped: ${reason}`);
  }

  private stop(reason: string): void {
    this.driving = false;
    this.wheel.stop(reason);
  }
}
