// The left stick of a gamepad.
import { type Direction, INTERRUPTION } from "./safety";
import { DEAD_ZONE } from "./stick";

export class GamepadStick {
  private held: Direction | null = null;
  private mustRest = false; // it was held when everything was let go

  constructor(private readonly onInterruption: (why: string) => void) {}

  get direction(): Direction | null {
    return this.held;
  }

  release(): void {
    this.mustRest = true;
    this.held = null;
  }

  /** Look where it stands now: gamepads tell nothing by themselves. */
  read(): void {
    const gamepad = connectedGamepad();
    if (!gamepad) {
      if (this.held) this.onInterruption(INTERRUPTION.gamepadGone);
      return;
    }
    const x = gamepad.axes[0] ?? 0;
    const y = -(gamepad.axes[1] ?? 0);
    const isMoved = Math.hypot(x, y) > DEAD_ZONE;
    if (!isMoved) this.mustRest = false;
    this.held = isMoved && !this.mustRest && document.hasFocus() ? [x, y] : null;
  }
}

function connectedGamepad(): Gamepad | null {
  if (!("getGamepads" in navigator)) return null; // some browsers have them only over https
  return navigator.getGamepads().find((gamepad) => gamepad?.connected) ?? null;
}
