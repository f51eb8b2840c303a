// Which board is shown: printed here, or another one with its numbers. The browser keeps it: all steps use one board.
import { toRobot } from "../link/address";
import { make, show } from "../ui/dom";
import { choice, link } from "./parts";

const KEY = "calibration board";
const KINDS: [string, string][] = [
  ["aprilgrid", "AprilGrid"],
  ["charuco", "ChArUco"],
  ["chessboard", "Chessboard, seen whole"],
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

interface Kept {
  kind: string;
  size: string;
  ruler?: string;
  measured: string[];
}

/** The fields of a form, and what they come to. */
export class BoardChoice {
  readonly print = link("", "Board to print (PDF)");
  readonly node: HTMLElement;
  private readonly kind = choice("Board", KINDS);
  private readonly size = choice("Paper", SIZES);
  // Empty until somebody has measured: a guess of 100 would be taken for a length, and the robot's metre with it.
  private readonly ruler = make("input", {
    type: "number",
    step: "any",
    min: "90",
    max: "110",
    required: true,
    placeholder: "100?",
  });
  private readonly printed = make("label", {}, "Its ruler measures, mm", this.ruler);
  private readonly measured = MEASURED.map(([, value]) =>
    make("input", { type: "number", step: "any", min: "1", required: true, value }),
  );
  private readonly other = make(
    "div",
    { class: "fields" },
    ...MEASURED.map(([label], i) => make("label", {}, label, this.measured[i])),
  );

  constructor() {
    const kept = read();
    if (kept) {
      this.kind.select.value = kept.kind;
      this.size.select.value = kept.size;
      this.ruler.value = kept.ruler ?? "";
      this.measured.forEach((input, i) => (input.value = kept.measured[i] ?? input.value));
    }
    const fields = make("div", { class: "fields" }, this.kind.label, this.size.label, this.printed);
    this.node = make("div", {}, fields, this.other);
    for (const input of [this.kind.select, this.size.select, this.ruler, ...this.measured])
      input.addEventListener("change", () => this.changed());
    this.refresh();
  }

  /** Whether every length is given that is asked for; the browser points at the first that is not. */
  isMeasured(): boolean {
    const asked = this.size.select.value === OTHER ? this.measured : [this.ruler];
    return asked.every((input) => input.reportValidity());
  }

  /** As POST /calibration/sessions wants it. */
  get target(): Record<string, string | number | undefined> {
    const kind = this.kind.select.value;
    if (this.size.select.value !== OTHER)
      return { kind, size: this.size.select.value, ruler_mm: Number(this.ruler.value) };
    const [columns, rows, square = NaN, gap = NaN] = this.measured.map((input) => Number(input.value));
    const more = { aprilgrid: { gap_m: gap / 1000 }, charuco: { marker_m: gap / 1000 }, chessboard: {} };
    return { kind, columns, rows, square_m: square / 1000, ...more[kind as keyof typeof more] };
  }

  private changed(): void {
    const kept: Kept = {
      kind: this.kind.select.value,
      size: this.size.select.value,
      ruler: this.ruler.value,
      measured: this.measured.map((input) => input.value),
    };
    localStorage.setItem(KEY, JSON.stringify(kept));
    this.refresh();
  }

  private refresh(): void {
    const isOther = this.size.select.value === OTHER;
    show(this.other, isOther);
    show(this.print, !isOther);
    show(this.printed, !isOther);
    const query = `kind=${this.kind.select.value}&size=${this.size.select.value}`;
    this.print.href = toRobot(`/calibration/target.pdf?${query}`);
  }
}

function read(): Kept | null {
  const text = localStorage.getItem(KEY);
  return text === null ? null : (JSON.parse(text) as Kept);
}
