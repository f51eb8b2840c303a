// Hold to drive. Commands go out 20 times a second while something is held; anything doubtful stops and says why.
import { call } from "../link/api";
import { driverName } from "../link/driver_name";
import type { CapabilitiesModel, DriveAnswer, DriveRequest, RobotModel } from "../link/messages";
import { LastingSocket } from "../link/socket";
import { by, setText, show } from "../ui/dom";
import { attempt } from "../ui/toast";
import type { VideoView } from "./video";

const REPEAT_MS = 50;
const TTL_MS = 200; // the page's silence becomes a stop within this, whatever happens to it
const KEYS: Record<string, [number, number]> = {
  KeyW: [0, 1],
  ArrowUp: [0, 1],
  KeyS: [0, -1],
  ArrowDown: [0, -1],
  KeyA: [-1, 0],
  ArrowLeft: [-1, 0],
  KeyD: [1, 0],
  ArrowRight: [1, 0],
};
const DEAD_ZONE = 0.12;
const TELL_AFTER_MS = 1500; // a picture this old is no hiccup: the control says that it cannot drive

export class DriveControl {
  private readonly socket: LastingSocket | null; // null: this visitor may only watch
  private readonly keys = new Set<string>();
  private stick: [number, number] | null = null;
  private pad: [number, number] | null = null;
  private padMustRest = false;
  private seq = 0;
  private saidSeq = 0; // the command before the sentence on the screen
  private heardMs: number | null = null; // the station's clock: shows that a command is not old when it arrives
  private isDriving = false;
  private youDrive = false;
  private driver: string | null = null;
  private able: CapabilitiesModel | null = null;
  private connected = false;
  private whyTimer = 0;

  constructor(
    private readonly video: VideoView,
    mayDrive: boolean,
  ) {
    this.socket = mayDrive ? this.connect() : null;
    this.listenToStick();
    this.listenToKeys();
    this.listenToPage();
    by("stop").addEventListener("click", () => this.emergencyStop("STOP"));
    by("take-over").addEventListener("click", () => this.send({ type: "take_over" }));
    by("head-ahead").addEventListener("click", () => {
      for (const id of ["pan", "tilt"]) by<HTMLInputElement>(id).value = "0";
      this.pointHead();
    });
    const speed = by<HTMLInputElement>("speed");
    speed.addEventListener("input", () => setText(by("speed-text"), `${speed.value} %`));
    for (const id of ["pan", "tilt"]) by(id).addEventListener("input", () => this.pointHead());
    setInterval(() => this.tick(), REPEAT_MS);
  }

  private connect(): LastingSocket {
    return new LastingSocket(
      `/ws/drive?driver=${encodeURIComponent(driverName)}`,
      (data) => this.take(JSON.parse(data as string) as DriveAnswer),
      (open) => {
        this.heardMs = null; // of another station, perhaps
        if (!open) this.halt("the station does not answer");
      },
    );
  }

  /** What the robot can do, and what its motors were told. */
  show(robot: RobotModel): void {
    this.able = robot.capabilities;
    this.connected = robot.connected;
    show(by("head"), Boolean(robot.connected && this.able?.pan_tilt));
    by("head").title = robot.head_must_rest;
    by<HTMLButtonElement>("head-ahead").disabled = robot.head_must_rest !== "";
    document.body.dataset["robot"] = robot.connected && robot.capabilities?.drive ? "drives" : "none";
    for (const id of ["pan", "tilt"]) {
      const slider = by<HTMLInputElement>(id);
      slider.disabled = robot.head_must_rest !== "";
      if (slider.disabled) slider.value = "0";
    }
    const v = robot.applied ?? { linear: 0, angular: 0 };
    if (!this.isDriving) showVelocity(v.linear, v.angular);
  }

  showDriver(driver: string | null): void {
    this.driver = driver;
    this.youDrive = driver === driverName;
    const other = driver !== null && !this.youDrive;
    setText(by("driver"), this.youDrive ? "You drive" : other ? `${driver} drives` : this.whyFree());
    by("driver").title = other ? `${driver} drives` : "";
    by("driver").classList.toggle("other", other);
    show(by("take-over"), other && this.socket !== null);
  }

  /** What a hand on the stick would do while nobody drives. */
  private whyFree(): string {
    if (!this.connected) return "No robot";
    if (!this.able?.drive) return "This robot cannot drive";
    return this.able.camera && this.video.ageMs > TELL_AFTER_MS ? "No driving: the picture is old" : "Hold to drive";
  }

  emergencyStop(reason: string): void {
    this.release();
    this.send({ type: "stop", reason });
    // Also by itself, and not for watchers only: the socket may be dead, and neither end told yet.
    attempt(() => call("POST", "/stop"));
    this.say("Stopped");
  }

  private send(request: DriveRequest): boolean {
    return this.socket?.send(JSON.stringify(request)) ?? false;
  }

  private take(answer: DriveAnswer): void {
    if (answer.type === "time") this.heardMs = answer.t_ms;
    else if (answer.type === "accepted" && answer.seq > this.saidSeq)
      show(by("why"), false); // it drives again: why it stopped is past
    else if (answer.type === "driver") this.showDriver(answer.driver);
    else if (answer.type === "refused") this.halt(answer.text, false); // a STOP of ours would stop the one who drives
  }

  /** Where the hands point: x right, y forward, -1..1. */
  private get direction(): [number, number] | null {
    if (this.stick) return this.stick;
    if (this.keys.size) {
      let [x, y] = [0, 0];
      for (const key of this.keys) {
        x += KEYS[key]![0];
        y += KEYS[key]![1];
      }
      return [Math.sign(x) * 0.7, Math.sign(y)];
    }
    return this.pad;
  }

  private tick(): void {
    this.readGamepad();
    if (this.driver === null) setText(by("driver"), this.whyFree()); // pictures grow old without anybody telling
    const direction = this.direction;
    if (!direction) {
      if (this.isDriving) this.stopDriving("");
      return;
    }
    if (!this.socket) {
      this.halt("your token may only watch");
      return;
    }
    if (!this.connected || !this.able) {
      this.halt("no robot is connected");
      return;
    }
    const doubt = this.handsElsewhere() || this.blind();
    if (doubt) {
      this.halt(doubt);
      return;
    }
    const limit = Number(by<HTMLInputElement>("speed").value) / 100;
    const [x, y] = direction;
    // Backwards, the robot turns as a car does: the stick's right stays the picture's right.
    const linear = y * limit * this.able.max_linear_m_s;
    const angular = -x * limit * this.able.max_angular_rad_s;
    this.seq += 1;
    if (!this.send({ type: "drive", seq: this.seq, linear, angular, ttl_ms: TTL_MS, heard_ms: this.heardMs })) {
      this.halt("the station does not answer");
      return;
    }
    this.isDriving = true;
    showVelocity(linear, angular);
  }

  /** Why this page shows nothing to drive by; empty when it does, and for a robot that has no camera. */
  private blind(): string {
    if (!this.able?.camera) return "";
    if (!this.video.hasPicture) return "no picture of the robot has come yet";
    return this.video.isStale ? `the picture is ${(this.video.ageMs / 1000).toFixed(1)} s old` : "";
  }

  /** Why the keyboard is somewhere where a STOP by the space bar might not be heard; empty when it is not. */
  private handsElsewhere(): string {
    if (document.querySelector("dialog[open]")) return "a dialog is open";
    return document.activeElement instanceof HTMLSelectElement ? "a list is being chosen from" : "";
  }

  private stopDriving(reason: string): void {
    this.isDriving = false;
    this.send({ type: "stop", reason });
  }

  /** Stop, let go of everything, and say why. It must be held anew to go on. */
  private halt(reason: string, tellRobot = true): void {
    const wasHeld = this.isDriving || this.direction !== null;
    this.release();
    if (!wasHeld) return;
    // What we have not set going may be another one's drive, and a STOP of ours would end it.
    if (tellRobot && this.isDriving) this.stopDriving(reason);
    this.isDriving = false;
    this.say(`Stopped: ${reason}`);
  }

  private release(): void {
    this.keys.clear();
    this.setStick(null);
    this.padMustRest = true;
    this.pad = null;
  }

  private say(text: string): void {
    const why = by("why");
    this.saidSeq = this.seq;
    why.textContent = text;
    show(why, true);
    clearTimeout(this.whyTimer);
    this.whyTimer = window.setTimeout(() => show(why, false), 5000);
  }

  private setStick(direction: [number, number] | null): void {
    this.stick = direction;
    const [x, y] = direction ?? [0, 0];
    by("knob").style.transform = `translate(${x * 100}%, ${-y * 100}%)`;
    by("stick").classList.toggle("held", direction !== null);
  }

  private listenToStick(): void {
    const stick = by("stick");
    let pointer: number | null = null;
    const move = (event: PointerEvent) => {
      const box = stick.getBoundingClientRect();
      const radius = box.width / 2;
      let x = (event.clientX - box.left - radius) / (radius * 0.66);
      let y = -(event.clientY - box.top - radius) / (radius * 0.66);
      const length = Math.hypot(x, y);
      if (length > 1) [x, y] = [x / length, y / length];
      this.setStick(length < DEAD_ZONE ? [0, 0] : [x, y]);
    };
    stick.addEventListener("pointerdown", (event) => {
      if (pointer !== null) return;
      event.preventDefault(); // which also leaves the keyboard where it is: in a list, it would not let us drive
      if (document.activeElement instanceof HTMLSelectElement) document.activeElement.blur();
      stick.setPointerCapture(event.pointerId);
      pointer = event.pointerId;
      move(event);
      this.tick();
    });
    stick.addEventListener("pointermove", (event) => {
      if (event.pointerId === pointer && this.stick) move(event);
    });
    stick.addEventListener("pointerup", (event) => {
      if (event.pointerId !== pointer) return;
      pointer = null;
      this.setStick(null);
      this.tick();
    });
    stick.addEventListener("pointercancel", (event) => {
      if (event.pointerId !== pointer) return;
      pointer = null;
      this.halt("the touch was interrupted");
    });
    stick.addEventListener("lostpointercapture", (event) => {
      if (event.pointerId !== pointer) return;
      pointer = null;
      this.halt("the pointer was lost");
    });
    stick.addEventListener("contextmenu", (event) => event.preventDefault());
  }

  private listenToKeys(): void {
    addEventListener("keydown", (event) => {
      // What is let go beside ⌘ is never told to a page (macOS): the robot would drive on.
      if (event.key === "Meta" && this.keys.size) this.halt("the Command or Windows key was pressed");
      if (isTyping(event.target)) return;
      if (event.code === "Space") {
        if (isTicked(event.target)) {
          // Its only key: it ticks the box, and stops what moves.
          if (this.driver !== null && !event.repeat) this.emergencyStop("STOP key");
          return;
        }
        event.preventDefault();
        if (!event.repeat) this.emergencyStop("STOP key");
      } else if (document.querySelector("dialog[open]") || event.target instanceof HTMLSelectElement) {
        return;
      } else if (event.code in KEYS && !isSlider(event.target) && !event.ctrlKey && !event.metaKey && !event.altKey) {
        event.preventDefault();
        if (event.repeat) return; // a key that was held while we stopped must be pressed anew
        this.keys.add(event.code);
        this.tick();
      }
    });
    addEventListener("keyup", (event) => {
      if (this.keys.delete(event.code)) this.tick();
    });
  }

  private listenToPage(): void {
    addEventListener("blur", () => this.halt("the window lost focus"));
    addEventListener("contextmenu", (event) => {
      if (!event.defaultPrevented) this.halt("a menu was opened"); // it keeps what is let go to itself
    });
    addEventListener("pagehide", () => this.halt("the page was closed"));
    document.addEventListener("visibilitychange", () => {
      if (document.hidden) this.halt("the page is hidden");
    });
  }

  private readGamepad(): void {
    const gamepad = navigator.getGamepads?.().find((g) => g?.connected);
    if (!gamepad) {
      if (this.pad) this.halt("the gamepad is gone");
      return;
    }
    const x = gamepad.axes[0] ?? 0;
    const y = -(gamepad.axes[1] ?? 0);
    const moved = Math.hypot(x, y) > DEAD_ZONE;
    if (!moved) this.padMustRest = false;
    this.pad = moved && !this.padMustRest && document.hasFocus() ? [x, y] : null;
  }

  private pointHead(): void {
    const angle = (id: string) => (Number(by<HTMLInputElement>(id).value) * Math.PI) / 180;
    this.send({ type: "pan_tilt", pan: -angle("pan"), tilt: angle("tilt") });
  }
}

function showVelocity(linear: number, angular: number): void {
  setText(by("linear"), `${linear.toFixed(2)} m/s`);
  setText(by("angular"), `${angular.toFixed(2)} rad/s`);
}

function isTyping(target: EventTarget | null): boolean {
  if (!(target instanceof HTMLElement)) return false;
  return target.matches("input:not([type=range], [type=checkbox], [type=radio]), textarea, [contenteditable]");
}

function isTicked(target: EventTarget | null): boolean {
  return target instanceof HTMLElement && target.matches("input[type=checkbox], input[type=radio]");
}

function isSlider(target: EventTarget | null): boolean {
  return target instanceof HTMLElement && target.matches("input[type=range]");
}
