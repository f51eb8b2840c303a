// The guided calibration: what to print, what to show, what came out of it.
import { call } from "../link/api";
import type { CalibrationModel, CalibrationSessionModel, JobModel } from "../link/messages";
import { by, context2d, make, present, setText, show } from "../ui/dom";
import { capitalised } from "../ui/text";
import { attempt } from "../ui/toast";
import { drawLooking } from "./overlay";
import { mountingOf } from "./mounting";
import { link, presentOf, progressOf, resultOf } from "./parts";

type Kind = CalibrationSessionModel["kind"];

const LEAST_VIEWS = 6;
const LEAST_TIME = 0.5; // of the seconds that are wanted
const TITLES: Record<Kind, string> = {
  camera: "Calibrate the camera",
  "camera-imu": "Calibrate camera and IMU",
};
const WHAT: [Kind, string][] = [
  ["camera", "Camera: its lens"],
  ["camera-imu", "Camera and IMU: how they sit"],
];
const STEPS: Record<Kind, string[]> = {
  camera: [
    "Glue it onto something flat: a board, a window pane. A bent one is noticed and refused.",
    "Turn the camera's focus ring until the picture is sharp; from now on leave it.",
    "Hold the board before the camera, and do what the page says.",
  ],
  "camera-imu": [
    "Calibrate the camera first: its lens must be known.",
    "Fix the board to a wall, flat and in good light. It must not move.",
    "Take the robot into your hand and wave it before the board for half a minute, as the page says.",
  ],
};
const BEGINNINGS: Record<Kind, string> = {
  camera: "Hold the board before the camera",
  "camera-imu": "Hold the robot before the board",
};
const ESTIMATING: Record<Kind, string> = {
  camera: "The camera is being estimated",
  "camera-imu": "Camera and IMU are being estimated",
};
const KINDS: [string, string][] = [
  ["aprilgrid", "AprilGrid: may be seen in part"],
  ["charuco", "ChArUco: may be seen in part"],
  ["chessboard", "Chessboard: must be seen whole"],
];
const OTHER = "other";
const SIZES: [string, string][] = [
  ["A4", "A4"],
  ["A3", "A3"],
  ["Letter", "Letter"],
  [OTHER, "Another board, measured"],
];
const MEASURED: [string, string][] = [
  ["Columns", "6"],
  ["Rows", "6"],
  ["Tag or square, mm", "24"],
  ["Gap or marker, mm", "7.2"],
];

/** One dialog, drawn anew for each step; while the board is looked at, only what changes. */
export class CalibrateDialog {
  private readonly dialog = by("calibrate-dialog", HTMLDialogElement);
  private session: CalibrationSessionModel | null = null;
  private told: CalibrationModel | null = null;
  private step = "";
  private isWaiting = false; // for the station's answer to a button

  constructor(
    private readonly video: HTMLCanvasElement,
    private readonly stop: (say: (text: string) => void) => void,
  ) {
    by("calibrate").addEventListener("click", () => attempt(() => this.open()));
    const followPicture = () => {
      if (this.dialog.open && this.session?.state === "looking") this.drawPicture();
      requestAnimationFrame(followPicture);
    };
    requestAnimationFrame(followPicture);
  }

  async open(): Promise<void> {
    await this.reload();
    this.step = "";
    this.dialog.showModal();
    this.draw();
  }

  /** The station told how it stands. */
  show(session: CalibrationSessionModel | null): void {
    this.session = session;
    if (this.dialog.open) this.draw();
  }

  showJob(job: JobModel): void {
    if (!this.dialog.open || job.id !== this.session?.job) return;
    const bar = this.dialog.querySelector("progress.estimate");
    if (bar instanceof HTMLProgressElement) bar.value = job.progress;
    const text = this.dialog.querySelector<HTMLElement>(".instruction");
    if (text && this.session.state === "estimating") setText(text, capitalised(job.message));
  }

  private async reload(): Promise<void> {
    const [told, sessions] = await Promise.all([
      call<CalibrationModel>("GET", "/calibration"),
      call<CalibrationSessionModel[]>("GET", "/calibration/sessions"),
    ]);
    this.told = told;
    this.session = sessions[0] ?? null;
  }

  private draw(): void {
    const step = this.session ? `${this.session.id} ${this.session.state}` : "start";
    if (step !== this.step) {
      this.step = step;
      const title = this.session ? TITLES[this.session.kind] : "Calibrate";
      this.dialog.replaceChildren(make("h2", {}, title), ...this.content(), this.stopping());
    }
    if (this.session?.state === "looking") this.drawProgress(this.session);
  }

  private content(): (Node | string)[] {
    switch (this.session?.state) {
      case "looking":
        return this.lookingContent(this.session);
      case "estimating":
        return [
          make("p", { class: "instruction", role: "status" }, ESTIMATING[this.session.kind]),
          make("progress", { class: "estimate", max: "1", value: "0", "aria-label": "Estimate" }),
          this.buttons(this.closing()),
        ];
      case "done":
      case "failed":
        return this.resultContent(this.session);
      default:
        return this.startContent();
    }
  }

  private startContent(): (Node | string)[] {
    const what = choice("What", WHAT);
    const kind = choice("Board", KINDS);
    const size = choice("Paper", SIZES);
    const print = link("/calibration/target.pdf", "Board to print (PDF)");
    const measured = MEASURED.map(([, value]) =>
      make("input", { type: "number", step: "any", min: "1", required: true, value }),
    );
    const other = make(
      "div",
      { class: "fields" },
      ...MEASURED.map(([label], i) => make("label", {}, label, measured[i])),
    );
    const steps = make("ol", { class: "steps" });
    const asked = () => what.select.value as Kind;
    const refresh = () => {
      const printing = make("li", {}, "Print the board at 100 %, and check the ruler on it. ", print);
      steps.replaceChildren(printing, ...STEPS[asked()].map((step) => make("li", {}, step)));
      const isOther = size.select.value === OTHER;
      show(other, isOther);
      show(print, !isOther);
      print.href = `/calibration/target.pdf?kind=${kind.select.value}&size=${size.select.value}`;
    };
    for (const { select } of [what, kind, size]) select.addEventListener("change", refresh);
    refresh();
    const numbers = () => {
      const [columns, rows, square = NaN, gap = NaN] = measured.map((input) => Number(input.value));
      const more = { aprilgrid: { gap_m: gap / 1000 }, charuco: { marker_m: gap / 1000 }, chessboard: {} };
      return { columns, rows, square_m: square / 1000, ...more[kind.select.value as keyof typeof more] };
    };
    const begin = () => {
      const board = size.select.value === OTHER ? numbers() : { size: size.select.value };
      const target = { kind: kind.select.value, ...board };
      return this.change(() => call("POST", "/calibration/sessions", { kind: asked(), target }));
    };
    return [
      ...(this.told ? presentOf(this.told) : []),
      make("div", { class: "fields" }, what.label, kind.label, size.label),
      other,
      steps,
      this.buttons(this.closing(), this.undoing(), this.button("Begin", begin, "primary")),
    ];
  }

  private lookingContent(session: CalibrationSessionModel): (Node | string)[] {
    const giveUp = () => this.change(() => call("DELETE", `/calibration/sessions/${session.id}`));
    const finish = () => this.change(() => call("POST", `/calibration/sessions/${session.id}/finish`));
    return [
      make("p", { class: "instruction", role: "status", "aria-live": "polite" }, BEGINNINGS[session.kind]),
      make("canvas", { class: "board", width: "640", height: "480", role: "img", "aria-label": "The board, as seen" }),
      make("div", { class: "progress-of" }),
      this.buttons(this.button("Give up", giveUp, "quiet apart"), this.button("Finish", finish, "primary finish")),
    ];
  }

  private drawProgress(session: CalibrationSessionModel): void {
    const seen = session.seen;
    if (seen) {
      setText(find(this.dialog, ".instruction", HTMLElement), capitalised(seen.instruction));
      find(this.dialog, ".progress-of", HTMLElement).replaceChildren(...progressOf(seen, session.kind));
    }
    const finish = find(this.dialog, ".finish", HTMLButtonElement);
    const [isEnough, text] = finishing(session);
    finish.disabled = this.isWaiting || !isEnough;
    setText(finish, text);
  }

  private drawPicture(): void {
    const canvas = this.dialog.querySelector("canvas.board");
    if (canvas instanceof HTMLCanvasElement) {
      drawLooking(context2d(canvas, { alpha: false }), this.video, this.session?.seen ?? null);
    }
  }

  private resultContent(session: CalibrationSessionModel): (Node | string)[] {
    const result = session.result ?? session.mounting;
    const use = () => this.change(() => call("POST", "/calibration/use", { session: session.id }));
    const isTold = this.isTold(session);
    const again = () => this.change(() => call("DELETE", `/calibration/sessions/${session.id}`));
    return present(
      ...(session.result ? resultOf(session, session.result) : []),
      ...(session.mounting ? mountingOf(session, session.mounting) : []),
      ...(result ? [] : [make("p", { class: "verdict bad", role: "status" }, capitalised(session.message))]),
      isTold &&
        make("p", { class: "note", role: "status" }, "The robot tells these numbers now; the ones before are kept."),
      make(
        "div",
        { class: "row wrap" },
        make("span", { class: "note" }, "Download"),
        result?.accepted && link(`/calibration/sessions/${session.id}/result.json`, "Result", "result.json"),
        isTold && link("/calibration/file", "calibration.yaml", "calibration.yaml"),
        isTold && link("/calibration/file?format=camchain", "kalibr", "camchain-imucam.yaml"),
        link(session.recording, "Recording", "recording.mcap"),
      ),
      this.buttons(
        this.button("Again", again, "quiet apart"),
        this.closing(),
        isTold ? this.undoing() : null,
        result?.accepted && !isTold ? this.button("Use it", use, "primary") : null,
      ),
    );
  }

  private isTold(session: CalibrationSessionModel): boolean {
    const camera = this.told?.camera;
    const result = session.result ?? session.mounting;
    if (!camera || !result || String(camera.intrinsics) !== String(result.intrinsics)) return false;
    return !session.mounting || String(camera.T_body_cam) === String(session.mounting.T_body_cam);
  }

  private undoing(): HTMLElement | null {
    if (!this.told?.can_undo || document.body.dataset.role !== "admin") return null;
    return this.button("Undo", () => this.change(() => call("POST", "/calibration/undo")));
  }

  /** The page's own STOP cannot be pressed behind a dialog. */
  private stopping(): HTMLElement {
    const said = make("span", { class: "note", role: "status" });
    const press = () => this.stop((text) => setText(said, text));
    return make(
      "div",
      { class: "stopping" },
      said,
      make("button", { type: "button", class: "stop", onclick: press }, "STOP"),
    );
  }

  private closing(): HTMLElement {
    return make("button", { type: "button", class: "quiet", onclick: () => this.dialog.close() }, "Close");
  }

  private button(text: string, act: () => Promise<unknown>, kind = ""): HTMLButtonElement {
    return make("button", { type: "button", class: kind, onclick: () => attempt(act) }, text);
  }

  private buttons(...children: (Node | null)[]): HTMLElement {
    return make("div", { class: "row end wrap" }, ...children);
  }

  /** Ask the station for something, then draw what it says; a second press meanwhile asks for nothing. */
  private async change(ask: () => Promise<unknown>): Promise<void> {
    if (this.isWaiting) return;
    this.isWaiting = true;
    try {
      await ask();
    } finally {
      this.isWaiting = false;
      await this.reload();
      this.step = "";
      this.draw();
    }
  }
}

/** Whether there may be enough to estimate from, and what the button says. */
function finishing({ kind, seen }: CalibrationSessionModel): [boolean, string] {
  const views = seen?.num_views ?? 0;
  if (kind === "camera-imu") {
    const time = seen?.poses.time ?? 0;
    return [time >= LEAST_TIME, time >= LEAST_TIME ? "Finish" : `Finish (${Math.floor(100 * time)} %)`];
  }
  if (views < LEAST_VIEWS) return [false, `Finish (${views} of ${LEAST_VIEWS} views)`];
  return [true, `Finish (${views} views)`];
}

function choice(text: string, options: [string, string][]): { select: HTMLSelectElement; label: HTMLElement } {
  const select = make("select", {}, ...options.map(([value, name]) => make("option", { value }, name)));
  return { select, label: make("label", {}, text, select) };
}

function find<T extends HTMLElement>(node: HTMLElement, selector: string, kind: new () => T): T {
  const found = node.querySelector(selector);
  if (!(found instanceof kind)) throw new Error(`the dialog has no ${selector}`);
  return found;
}
