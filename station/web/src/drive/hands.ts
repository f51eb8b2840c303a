// Everything a person may hold to drive; of several that are held, buttons and joystick count before keys, then a gamepad.
import { GamepadStick } from "./gamepad";
import { Keyboard, type KeyboardEvents } from "./keyboard";
import { Pad } from "./pad";
import { type Direction, type Hands, INTERRUPTION } from "./safety";
import { Stick } from "./stick";

export class PageHands implements Hands {
  readonly pad: Pad; // in a dialog that wants driving
  private readonly stick: Stick;
  private readonly keyboard: Keyboard;
  private readonly gamepad: GamepadStick;

  constructor(events: KeyboardEvents) {
    this.pad = new Pad(events.onChange, events.onInterruption);
    this.stick = new Stick(events.onChange, events.onInterruption);
    this.keyboard = new Keyboard(events);
    this.gamepad = new GamepadStick(events.onInterruption);
    watchPage(events.onInterruption);
  }

  get direction(): Direction | null {
    return this.pad.direction ?? this.stick.direction ?? this.keyboard.direction ?? this.gamepad.direction;
  }

  release(): void {
    for (const input of [this.pad, this.stick, this.keyboard, this.gamepad]) input.release();
  }

  readGamepad(): void {
    this.gamepad.read();
  }
}

/** Where the person leaves the page, nothing of what they let go reaches it. */
function watchPage(onInterruption: (why: string) => void): void {
  addEventListener("blur", () => onInterruption(INTERRUPTION.windowLeft));
  addEventListener("contextmenu", (event) => {
    if (!event.defaultPrevented) onInterruption(INTERRUPTION.menuOpened);
  });
  addEventListener("pagehide", () => onInterruption(INTERRUPTION.pageClosed));
  document.addEventListener("visibilitychange", () => {
    if (document.hidden) onInterruption(INTERRUPTION.pageHidden);
  });
}
