// The guided calibration: what to print, what to show, what came out of it.
import { call } from "../link/api";
import type { CalibrationModel, CalibrationSessionModel, JobModel } from "../link/messages";
import { by, context2d, make, present, setText, show } from "../ui/dom";
import { capitalised, count } from "../ui/text";
import { attempt } from "../ui/toast";
import { BoardChoice } from "./board";
import { checkOf, repairs } from "./check";
import { after, CHOICES, GUIDED, type Kind } from "./kinds";
import { mountingOf } from "./mounting";
import { imuOf, wheelsOf } from "./outcome";
import { drawLooking } from "./overlay";
import { choice, link, presentOf, progressOf, resultOf } from "./parts";

const ONLY_ADMINS = "Only an admin's token lets the robot use what comes of it; with yours it can be downloaded.";

interface Outcome {
  accepted: boolean;
}

/** One dialog, drawn anew for each step; while the board is looked at, only what changes. */
export class CalibrateDialog {
  private readonly dialog = by("calibrate-dialog", HTMLDialogElement);
  private session: CalibrationSessionModel | null = null;
  private told: CalibrationModel | null = null;
  private step = "";
  private newest: Kind = "camera"; // what was begun last: "Again" is of the same
  private next: Kind | null = null; // chosen after a result; the session of that is forgotten when this one begins
  private isWaiting = false; // for the station's answer to a button

  constructor(
    private readonly video: HTMLCanvasElement,
    private readonly pad: HTMLElement,
    private readonly stop: (say: (text: string) => void) => void,
  ) {
    by("calibrate").addEventListener("click", () => attempt(() => this.open()));
  }

  async open(): Promise<void> {
    await this.reload();
    this.step = "";
    this.next = null;
    this.dialog.showModal();
    this.draw();
  }

  /** The station told how it stands. */
  show(session: CalibrationSessionModel | null): void {
    const wasUsed = this.session?.is_used;
    this.take(session);
    if (!this.dialog.open) return;
    this.draw();
    if (session && session.is_used !== Boolean(wasUsed)) attempt(() => this.refresh()); // perhaps on another page
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
    this.take(sessions[0] ?? null);
  }

  private async refresh(): Promise<void> {
    await this.reload();
    this.step = "";
    this.draw();
  }

  private take(session: CalibrationSessionModel | null): void {
    this.session = session;
    if (session) this.newest = session.kind;
    if (session?.state === "looking") this.next = null; // begun here or on another page
  }

  private draw(): void {
    const step =
      this.next ??
      (this.session ? `${this.session.id} ${this.session.state} ${String(this.session.is_used)}` : "start");
    if (step !== this.step) {
      this.step = step;
      const title = this.session && !this.next ? GUIDED[this.session.kind].title : "Calibrate";
      const content = this.content();
      const buttons = content.pop();
      const footer = make("div", { class: "footer" }, this.stopping(), buttons);
      this.dialog.replaceChildren(make("h2", {}, title), ...content, footer);
    }
    if (this.session?.state === "looking") this.drawProgress(this.session);
    this.showPicture();
  }

  private content(): (Node | string)[] {
    if (this.next) return this.startContent(this.next);
    switch (this.session?.state) {
      case "looking":
        return this.lookingContent(this.session);
      case "estimating":
        return [
          make("p", { class: "instruction", role: "status" }, GUIDED[this.session.kind].estimating),
          make("progress", { class: "estimate", max: "1", value: "0", "aria-label": "Estimate" }),
          this.buttons(this.closing()),
        ];
      case "done":
      case "failed":
        return this.resultContent(this.session);
      default:
        return this.startContent(this.newest);
    }
  }

  private startContent(chosen: Kind): (Node | string)[] {
    const what = choice("What", CHOICES);
    what.select.value = chosen;
    const board = new BoardChoice();
    const steps = make("ol", { class: "steps" });
    const sharp = picture("The live picture"); // the dialog hides it elsewhere, and the lens is turned by it
    const asked = () => what.select.value as Kind;
    const refresh = () => {
      const guided = GUIDED[asked()];
      const printing = make("li", {}, "Print the board at 100 %, and measure the ruler on it. ", board.print);
      show(board.node, guided.looks);
      show(sharp, asked() === "camera");
      this.showPicture();
      steps.replaceChildren(...present(guided.looks && printing, ...guided.steps.map((step) => make("li", {}, step))));
    };
    what.select.addEventListener("change", refresh);
    refresh();
    const begin = async () => {
      const { looks } = GUIDED[asked()];
      if (looks && !board.isMeasured()) return;
      const target = looks ? board.target : null;
      await this.change(() => call("POST", "/calibration/sessions", { kind: asked(), target }));
    };
    return [
      ...(this.told ? presentOf(this.told) : []),
      ...(isAdmin() ? [] : [make("p", { class: "note bad" }, ONLY_ADMINS)]),
      make("div", { class: "fields" }, what.label),
      board.node,
      steps,
      sharp,
      this.buttons(this.closing(), this.undoing(), this.button("Begin", begin, "primary")),
    ];
  }

  private lookingContent(session: CalibrationSessionModel): (Node | string)[] {
    const giveUp = () => this.change(() => call("DELETE", `/calibration/sessions/${session.id}`));
    const finish = () => this.change(() => call("POST", `/calibration/sessions/${session.id}/finish`));
    const guided = GUIDED[session.kind];
    return present(
      make("p", { class: "instruction", role: "status", "aria-live": "polite" }, guided.beginning),
      guided.looks && picture("The board, as seen"),
      make("div", { class: "progress-of" }),
      session.kind === "wheels" && this.pad,
      this.buttons(
        this.button("Give up", giveUp, "quiet apart"),
        session.kind === "imu" && this.closing(),
        this.button("Finish", finish, "primary finish"),
      ),
    );
  }

  private drawProgress(session: CalibrationSessionModel): void {
    const seen = session.seen;
    if (seen) {
      setText(find(this.dialog, ".instruction", HTMLElement), capitalised(seen.instruction));
      find(this.dialog, ".progress-of", HTMLElement).replaceChildren(...progressOf(seen, session.kind));
    }
    const finish = find(this.dialog, ".finish", HTMLButtonElement);
    finish.disabled = this.isWaiting || !seen?.may_finish;
    setText(finish, finishText(session));
  }

  /** The live picture is a new one, or what was seen on it. */
  showPicture(): void {
    const canvas = this.dialog.open ? this.dialog.querySelector("canvas.board") : null;
    if (canvas instanceof HTMLCanvasElement && !canvas.hidden) {
      const seen = this.session?.state === "looking" ? this.session.seen : null;
      drawLooking(context2d(canvas, { alpha: false }), this.video, seen);
    }
  }

  private resultContent(session: CalibrationSessionModel): (Node | string)[] {
    const result = outcomeOf(session);
    const use = () => this.change(() => call("POST", "/calibration/use", { session: session.id }));
    const isTold = session.is_used;
    const following = after(session.kind);
    const goOn = () => {
      this.next = following;
      this.draw();
      return Promise.resolve();
    };
    const again = () => this.change(() => call("DELETE", `/calibration/sessions/${session.id}`));
    return present(
      ...(session.result ? resultOf(session, session.result) : []),
      ...(session.mounting ? mountingOf(session, session.mounting) : []),
      ...(session.check ? checkOf(session.check) : []),
      ...(session.wheels ? wheelsOf(session, session.wheels) : []),
      ...(session.imu ? imuOf(session, session.imu) : []),
      ...(result ? [] : [make("p", { class: "verdict bad", role: "status" }, capitalised(session.message))]),
      isTold &&
        make("p", { class: "note", role: "status" }, "The robot tells these numbers now; the ones before are kept."),
      make(
        "div",
        { class: "row wrap" },
        make("span", { class: "note" }, "Download"),
        result?.accepted && link(`/calibration/sessions/${session.id}/result.json`, "Result", "result.json"),
        isTold && link("/calibration/file", "calibration.yaml", "calibration.yaml"),
        isTold &&
          GUIDED[session.kind].looks &&
          link("/calibration/file?format=camchain", "kalibr", "camchain-imucam.yaml"),
        link(session.recording, "Recording", "recording.mcap"),
      ),
      this.buttons(
        this.button("Again", again, "quiet apart"),
        this.closing(),
        isTold ? this.undoing() : null,
        result?.accepted && repairs(session.check) && !isTold && isAdmin()
          ? this.button("Use it", use, "primary")
          : null,
        isTold && following ? this.button(`Next: ${GUIDED[following].next}`, goOn, "primary") : null,
      ),
    );
  }

  private undoing(): HTMLElement | null {
    if (!this.told?.can_undo || !isAdmin()) return null;
    return this.button("Undo", () => this.change(() => call("POST", "/calibration/undo")));
  }

  /** The page's own STOP cannot be pressed behind a dialog. */
  private stopping(): HTMLElement {
    const said = make("span", { class: "note", role: "status" });
    const press = () => this.stop((text) => setText(said, text));
    return make(
      "div",
      { class: "stopping" },
      make("button", { type: "button", class: "stop", onclick: press }, "STOP"),
      said,
    );
  }

  private closing(): HTMLElement {
    return make("button", { type: "button", class: "quiet", onclick: () => this.dialog.close() }, "Close");
  }

  private button(text: string, act: () => Promise<unknown>, kind = ""): HTMLButtonElement {
    return make("button", { type: "button", class: kind, onclick: () => attempt(act) }, text);
  }

  private buttons(...children: (Node | null | false)[]): HTMLElement {
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
      await this.refresh();
    }
  }
}

/** How many views or moves count, on the button. */
function finishText({ kind, seen }: CalibrationSessionModel): string {
  const views = seen?.num_views ?? 0;
  return kind === "camera" ? `Finish (${count(views, "view")})` : "Finish";
}

/** What it came to, whatever was calibrated. */
const outcomeOf = (session: CalibrationSessionModel): Outcome | null =>
  session.result ?? session.mounting ?? session.check ?? session.wheels ?? session.imu;

/** Only an admin changes what the robot tells. */
const isAdmin = (): boolean => document.body.dataset.role === "admin";

function find<T extends HTMLElement>(node: HTMLElement, selector: string, kind: new () => T): T {
  const found = node.querySelector(selector);
  if (!(found instanceof kind)) throw new Error(`the dialog has no ${selector}`);
  return found;
}

function picture(label: string): HTMLCanvasElement {
  return make("canvas", { class: "board", width: "640", height: "480", role: "img", "aria-label": label });
}
