// The joystick on the page: one finger or mouse button holds it.
import { by } from "../ui/dom";
import { type Direction, INTERRUPTION } from "./safety";

export const DEAD_ZONE = 0.12; // a hand that rests on a stick does not steer

export class Stick {
  private readonly node = by("stick");
  private readonly knob = by("knob");
  private pointer: number | null = null;
  private held: Direction | null = null;

  constructor(
    private readonly onChange: () => void,
    private readonly onInterruption: (why: string) => void,
  ) {
    this.node.addEventListener("pointerdown", (event) => this.grab(event));
    this.node.addEventListener("pointermove", (event) => {
      if (event.pointerId === this.pointer && this.held) this.move(event);
    });
    this.node.addEventListener("pointerup", (event) => {
      if (event.pointerId !== this.pointer) return;
      this.pointer = null;
      this.release();
      this.onChange();
    });
    this.node.addEventListener("pointercancel", (event) => this.lose(event, INTERRUPTION.touchCancelled));
    this.node.addEventListener("lostpointercapture", (event) => this.lose(event, INTERRUPTION.pointerLost));
    this.node.addEventListener("contextmenu", (event) => event.preventDefault());
  }

  get direction(): Direction | null {
    return this.held;
  }

  release(): void {
    this.set(null);
  }

  private grab(event: PointerEvent): void {
    if (this.pointer !== null) return;
    event.preventDefault(); // which also leaves the keyboard where it is: in a list, it would not let us drive
    if (document.activeElement instanceof HTMLSelectElement) document.activeElement.blur();
    this.node.setPointerCapture(event.pointerId);
    this.pointer = event.pointerId;
    this.move(event);
    this.onChange();
  }

  private move(event: PointerEvent): void {
    const box = this.node.getBoundingClientRect();
    const radius = box.width / 2;
    let x = (event.clientX - box.left - radius) / (radius * 0.66);
    let y = -(event.clientY - box.top - radius) / (radius * 0.66);
    const length = Math.hypot(x, y);
    if (length > 1) [x, y] = [x / length, y / length];
    this.set(length < DEAD_ZONE ? [0, 0] : [x, y]);
  }

  private lose(event: PointerEvent, why: string): void {
    if (event.pointerId !== this.pointer) return;
    this.pointer = null;
    this.onInterruption(why);
  }

  private set(direction: Direction | null): void {
    this.held = direction;
    const [x, y] = direction ?? [0, 0];
    this.knob.style.transform = `translate(${x * 100}%, ${-y * 100}%)`;
    this.node.classList.toggle("held", direction !== null);
  }
}
