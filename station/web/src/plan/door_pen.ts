// Drawing a door: press at one wall, let go at the other.
import type { Fit } from "./fit";
import { draw, type Point } from "./svg";

const SHORTEST_PX = 12;

export class DoorPen {
  private from: Point | null = null;
  private hasDrawn = false; // since the pointer went down: what it lies on is not pressed
  private readonly line = draw("line", { class: "plan-pen" });

  /** `onDrawn` gets the ends on the plan. */
  constructor(
    private readonly svg: SVGSVGElement,
    private readonly fit: () => Fit | null,
    private readonly onDrawn: (line: [Point, Point]) => void,
  ) {
    svg.addEventListener("pointerdown", (event) => this.begin(event), { capture: true });
    svg.addEventListener("pointermove", (event) => this.draw(event));
    svg.addEventListener("pointerup", (event) => this.end(event));
    svg.addEventListener("pointercancel", () => this.drop());
    svg.addEventListener("click", (event) => this.press(event), { capture: true });
  }

  get isOut(): boolean {
    return this.svg.classList.contains("drawing");
  }

  /** Take it out, or put it away. */
  take(isOut: boolean): void {
    this.svg.classList.toggle("drawing", isOut);
    if (!isOut) this.drop();
  }

  private begin(event: PointerEvent): void {
    this.hasDrawn = this.isOut;
    if (!this.isOut) return;
    event.preventDefault();
    event.stopPropagation();
    this.svg.setPointerCapture(event.pointerId);
    this.from = this.at(event);
    this.draw(event);
    this.svg.append(this.line);
  }

  private draw(event: PointerEvent): void {
    if (!this.from) return;
    const [x2, y2] = this.at(event);
    for (const [name, value] of Object.entries({ x1: this.from[0], y1: this.from[1], x2, y2 }))
      this.line.setAttribute(name, String(value));
  }

  private end(event: PointerEvent): void {
    const [from, to, fit] = [this.from, this.at(event), this.fit()];
    this.drop();
    if (!from || !fit || Math.hypot(to[0] - from[0], to[1] - from[1]) < SHORTEST_PX) return;
    this.onDrawn([fit.toPlan(from), fit.toPlan(to)]);
  }

  private press(event: Event): void {
    if (this.hasDrawn) event.stopPropagation();
    this.hasDrawn = false;
  }

  private drop(): void {
    this.from = null;
    this.line.remove();
  }

  private at(event: PointerEvent): Point {
    const box = this.svg.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  }
}
