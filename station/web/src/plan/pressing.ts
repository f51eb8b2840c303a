// Pressing and pointing at parts of the drawing: one listener for all of them, of which there may be thousands.
import { draw, withData } from "./svg";

export interface PressingEvents {
  onPress: (part: SVGElement) => void;
  /** The pointer is over a part, or its keyboard focus is; null: over none any more. */
  onHover: (part: SVGElement | null) => void;
}

/** By mouse, touch and keyboard. `host` is no SVG element: Chromium gives those the focus that listen for it. */
export function listenTo(host: HTMLElement, { onPress, onHover }: PressingEvents): void {
  host.addEventListener("click", (event) => {
    const part = partOf(event);
    part?.focus({ preventScroll: true }); // a name takes none, and closing a dialog gives it back
    if (part) onPress(part);
  });
  host.addEventListener("keydown", (event) => {
    const part = partOf(event);
    if (!part || (event.key !== "Enter" && event.key !== " ")) return;
    event.preventDefault();
    onPress(part);
  });
  for (const type of ["pointerover", "focusin"] as const)
    host.addEventListener(type, (event) => {
      const part = partOf(event);
      if (part) giveTitle(part);
      onHover(part);
    });
  for (const type of ["pointerleave", "focusout"] as const) host.addEventListener(type, () => onHover(null));
}

/** A room's name stands for the room. */
function partOf({ target }: Event): SVGElement | null {
  if (!(target instanceof SVGElement)) return null;
  const name = target.closest<SVGElement>(".plan-names [data-room]");
  if (!name) return target.closest<SVGElement>("[role=button]");
  return target.ownerSVGElement?.querySelector(`.plan-room${withData("room", name.dataset.room ?? "")}`) ?? null;
}

/** What it is called, beside the pointer that rests on it. */
function giveTitle(part: SVGElement): void {
  const label = part.getAttribute("aria-label");
  if (label !== null && !part.querySelector("title")) part.append(draw("title", {}, label));
}
