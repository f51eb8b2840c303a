// Hold to drive. Commands go out 20 times a second while something is held; anything doubtful stops and says why (safety.ts).
import { call } from "../link/api";
import { driverName } from "../link/driver_name";
import type { CapabilitiesModel, NetworkModel, RobotModel, StopModel } from "../link/messages";
import { by, show } from "../ui/dom";
import { attempt } from "../ui/toast";
import { dialogIsOpen, isList } from "./focus";
import { PageHands } from "./hands";
import { HeadControl } from "./head";
import { DriveLine } from "./line";
import { DrivePanel } from "./panel";
import {
  type Direction,
  DriveGuard,
  INTERRUPTION,
  invitation,
  type Situation,
  SlowestSecond,
  speedShare,
  youDrive,
} from "./safety";
import type { VideoView } from "./video";

const REPEAT_MS = 50;

export class DriveControl {
  private readonly line: DriveLine | null; // null: this visitor may only watch
  private readonly panel = new DrivePanel();
  private readonly head = new HeadControl((pan, tilt) => this.line?.send({ type: "pan_tilt", pan, tilt }));
  private readonly hands: PageHands;
  private readonly guard: DriveGuard;
  private driver: string | null = null;
  private robot: CapabilitiesModel | null = null;
  private isConnected = false;
  private network: NetworkModel | null = null;
  private share = 1; // of the wanted speed, as delays leave it
  private readonly pictureAges = new SlowestSecond();

  constructor(
    private readonly video: VideoView,
    mayDrive: boolean,
  ) {
    this.hands = new PageHands({
      onChange: () => this.tick(),
      onStop: () => this.emergencyStop("STOP key"),
      onInterruption: (why) => this.guard.halt(why),
      somebodyDrives: () => this.driver !== null,
    });
    this.guard = new DriveGuard(this.hands, {
      drive: (direction) => this.drive(direction),
      stop: (reason) => this.line?.send({ type: "stop", reason }),
      say: (text) => this.say(text),
    });
    this.line = mayDrive ? this.connect() : null;
    by("stop").addEventListener("click", () => this.emergencyStop("STOP"));
    by("take-over").addEventListener("click", () => this.line?.send({ type: "take_over" }));
    setInterval(() => this.tick(), REPEAT_MS);
  }

  private connect(): DriveLine {
    return new DriveLine({
      onLost: () => this.guard.halt(INTERRUPTION.stationSilent),
      onDriver: (driver) => this.showDriver(driver),
      onAccepted: (seq) => this.panel.accept(seq),
      onRefused: (text) => this.guard.refuse(text),
    });
  }

  /** What the robot can do, and what its motors were told. */
  show(robot: RobotModel): void {
    this.robot = robot.capabilities;
    this.isConnected = robot.connected;
    this.network = robot.network;
    this.head.show(robot);
    this.panel.showAhead(robot.ahead);
    document.body.dataset.robot = robot.connected && robot.capabilities?.drive ? "drives" : "none";
    const v = robot.applied ?? { linear: 0, angular: 0 };
    if (!this.guard.isDriving) this.panel.showVelocity(v.linear, v.angular);
  }

  showDriver(driver: string | null): void {
    this.driver = driver;
    const other = driver === driverName ? null : driver;
    const free = driver === null ? invitation(this.situation()) : youDrive(this.share, this.network);
    this.panel.showDriver(other === null ? free : `${other} drives`, other);
    show(by("take-over"), other !== null && this.line !== null);
  }

  private tick(): void {
    this.hands.readGamepad();
    const situation = this.situation();
    this.share = speedShare(
      this.pictureAges.note(ageOf(situation), performance.now()),
      this.network?.round_trip_ms ?? 0,
    );
    if (this.driver === driverName) this.showDriver(this.driver);
    if (this.driver === null) this.panel.showInvitation(invitation(situation)); // pictures grow old without anybody telling
    this.guard.tick(situation);
  }

  private situation(): Situation {
    return {
      mayDrive: this.line !== null,
      isConnected: this.isConnected,
      robot: this.robot,
      dialogIsOpen: dialogIsOpen() && this.hands.pad.direction === null,
      listIsOpen: isList(document.activeElement),
      pictureAgeMs: this.video.ageMs,
    };
  }

  private drive([x, y]: Direction): boolean {
    if (!this.line || !this.robot) return false;
    const limit = this.panel.speedLimit * this.share;
    // Backwards, the robot turns as a car does: the stick's right stays the picture's right.
    const linear = y * limit * this.robot.max_linear_m_s;
    const angular = -x * limit * this.robot.max_angular_rad_s;
    if (!this.line.drive(linear, angular)) return false;
    this.panel.showVelocity(linear, angular);
    return true;
  }

  /** `say` tells whoever pressed it what became of it. */
  emergencyStop(reason: string, say = (text: string) => this.say(text)): void {
    this.hands.release();
    this.line?.send({ type: "stop", reason });
    // Also by itself, and not for watchers only: the socket may be dead, and neither end told yet.
    say("STOP sent");
    attempt(async () => {
      const { confirmed } = await call<StopModel>("POST", "/stop");
      say(confirmed ? "Stopped" : "STOP sent, but the robot has not confirmed it yet");
    });
  }

  /** Buttons to drive by, for a dialog that covers the joystick and has a STOP of its own. */
  get pad(): HTMLElement {
    return this.hands.pad.node;
  }

  private say(text: string): void {
    this.hands.pad.say(text);
    this.panel.say(text, this.line?.newestSeq ?? 0);
  }
}

/** Where no camera looks, or no picture has come, there is nothing late to drive by. */
function ageOf(situation: Situation): number {
  return situation.robot?.camera && situation.pictureAgeMs < Infinity ? situation.pictureAgeMs : 0;
}
