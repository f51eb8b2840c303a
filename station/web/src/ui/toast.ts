// A sentence at the edge of the page that goes by itself.
import { by, make } from "./dom";
import { sentence } from "./text";

let toastTimer = 0;

/** What can be done about it. */
interface Remedy {
  label: string;
  act: () => Promise<unknown>;
}

/** How long a sentence stays, ms. */
const STAYS = { alone: 6000, withRemedy: 15_000, whileWorking: 120_000 };

/** A sentence for a while; with what can be done about it, for longer. */
export function toast(text: string, remedy?: Remedy): void {
  tell(text, remedy ? STAYS.withRemedy : STAYS.alone, remedy);
}

/** A sentence about what takes its time, until the next one says what came of it. */
export function working(text: string): void {
  tell(text, STAYS.whileWorking);
}

function tell(text: string, forMs: number, remedy?: Remedy): void {
  const node = by("toast");
  node.replaceChildren(make("span", {}, text));
  if (remedy) {
    const run = () => {
      node.hidden = true;
      attempt(remedy.act);
    };
    node.append(make("button", { type: "button", class: "small", onclick: run }, remedy.label));
  }
  node.hidden = false;
  clearTimeout(toastTimer);
  toastTimer = window.setTimeout(() => (node.hidden = true), forMs);
}

/** Run an action of a button; its failure becomes a sentence on the screen. */
export function attempt(action: () => Promise<unknown>): void {
  action().catch((error: unknown) => toast(sentence(error)));
}
