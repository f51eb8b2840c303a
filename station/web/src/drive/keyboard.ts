// Driving by W A S D or the arrows, and STOP by the space bar.
import { dialogIsOpen, isList, isSlider, isText, isTickBox } from "./focus";
import { type Direction, INTERRUPTION } from "./safety";

const KEYS = new Map<string, Direction>([
  ["KeyW", [0, 1]],
  ["ArrowUp", [0, 1]],
  ["KeyS", [0, -1]],
  ["ArrowDown", [0, -1]],
  ["KeyA", [-1, 0]],
  ["ArrowLeft", [-1, 0]],
  ["KeyD", [1, 0]],
  ["ArrowRight", [1, 0]],
]);
const TURN = 0.7; // of the whole speed: a key has no half way

export interface KeyboardEvents {
  onChange: () => void;
  onStop: () => void;
  onInterruption: (why: string) => void;
  somebodyDrives: () => boolean;
}

export class Keyboard {
  private readonly held = new Map<string, Direction>();

  constructor(private readonly events: KeyboardEvents) {
    addEventListener("keydown", (event) => this.press(event));
    addEventListener("keyup", (event) => {
      if (this.held.delete(event.code)) this.events.onChange();
    });
  }

  get direction(): Direction | null {
    if (!this.held.size) return null;
    let [x, y] = [0, 0];
    for (const [right, forward] of this.held.values()) {
      x += right;
      y += forward;
    }
    return [Math.sign(x) * TURN, Math.sign(y)];
  }

  release(): void {
    this.held.clear();
  }

  private press(event: KeyboardEvent): void {
    if (event.key === "Meta" && this.held.size) this.events.onInterruption(INTERRUPTION.metaKey);
    if (isText(event.target)) return;
    if (event.code === "Space") this.pressSpace(event);
    else if (!dialogIsOpen() && !isList(event.target)) this.pressToDrive(event);
  }

  private pressSpace(event: KeyboardEvent): void {
    if (isTickBox(event.target)) {
      // Its only key: it ticks the box, and stops what moves.
      if (this.events.somebodyDrives() && !event.repeat) this.events.onStop();
      return;
    }
    event.preventDefault();
    if (!event.repeat) this.events.onStop();
  }

  private pressToDrive(event: KeyboardEvent): void {
    const direction = KEYS.get(event.code);
    if (!direction || isSlider(event.target) || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    if (event.repeat) return; // a key that was held while we stopped must be pressed anew
    this.held.set(event.code, direction);
    this.events.onChange();
  }
}
