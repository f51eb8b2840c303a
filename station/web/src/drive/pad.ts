// Buttons that are held to drive, for where the joystick is covered: straight on and back, turns on the spot, no arcs.
import { make, setText } from "../ui/dom";
import { type Direction, INTERRUPTION } from "./safety";

const SPEED = 0.5; // of the whole speed: ways and turns of two seconds
const WAYS: [name: string, sign: string, direction: Direction][] = [
  ["Turn left", "↺", [-SPEED, 0]],
  ["Forth", "↑", [0, SPEED]],
  ["Back", "↓", [0, -SPEED]],
  ["Turn right", "↻", [SPEED, 0]],
];

export class Pad {
  private readonly said = make("span", { class: "note", role: "status" });
  readonly node = make("div", { class: "pad", role: "group", "aria-label": "Drive" });
  private pointer: number | null = null;
  private held: Direction | null = null;

  constructor(
    private readonly onChange: () => void,
    private readonly onInterruption: (why: string) => void,
  ) {
    const buttons = WAYS.map(([name, sign, direction]) => {
      const button = make("button", { type: "button", "aria-label": name, title: `Hold: ${name}` }, sign);
      button.addEventListener("pointerdown", (event) => this.grab(event, button, direction));
      button.addEventListener("pointerup", (event) => this.letGo(event));
      button.addEventListener("pointercancel", (event) => this.lose(event, INTERRUPTION.touchCancelled));
      button.addEventListener("lostpointercapture", (event) => this.lose(event, INTERRUPTION.pointerLost));
      button.addEventListener("contextmenu", (event) => event.preventDefault());
      return button;
    });
    this.node.append(...buttons, this.said);
  }

  get direction(): Direction | null {
    return this.held;
  }

  release(): void {
    this.held = null;
  }

  /** Why it does not drive, to whoever holds a button. */
  say(text: string): void {
    setText(this.said, text);
  }

  private grab(event: PointerEvent, button: HTMLElement, direction: Direction): void {
    if (this.pointer !== null) return;
    event.preventDefault();
    button.setPointerCapture(event.pointerId);
    this.pointer = event.pointerId;
    this.held = direction;
    this.say("");
    this.onChange();
  }

  private letGo(event: PointerEvent): void {
    if (event.pointerId !== this.pointer) return;
    this.pointer = null;
    this.release();
    this.onChange();
  }

  private lose(event: PointerEvent, why: string): void {
    if (event.pointerId !== this.pointer) return;
    this.pointer = null;
    this.onInterruption(why);
  }
}
