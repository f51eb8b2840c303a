// A sentence at the edge of the page that goes by itself.
import { by, make } from "./dom";
import { sentence } from "./text";

let toastTimer = 0;

/** A sentence for a while; with what can be done about it, for longer. */
export function toast(text: string, action = "", act: () => Promise<unknown> = async () => {}): void {
  const node = by("toast");
  const run = () => {
    node.hidden = true;
    attempt(act);
  };
  node.replaceChildren(
    make("span", {}, text),
    ...(action ? [make("button", { type: "button", class: "small", onclick: run }, action)] : []),
  );
  node.hidden = false;
  clearTimeout(toastTimer);
  toastTimer = window.setTimeout(() => (node.hidden = true), action ? 15_000 : 6000);
}

/** Run an action of a button; its failure becomes a sentence on the screen. */
export function attempt(action: () => Promise<unknown>): void {
  action().catch((error: unknown) => toast(sentence(error)));
}
