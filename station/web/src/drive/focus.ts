// Where the keyboard is, so far as driving by keys depends on it.

export function dialogIsOpen(): boolean {
  return document.querySelector("dialog[open]") !== null;
}

export function isList(target: EventTarget | null): boolean {
  return target instanceof HTMLSelectElement;
}

/** Whether keys write text there. */
export function isText(target: EventTarget | null): boolean {
  return matches(target, "input:not([type=range], [type=checkbox], [type=radio]), textarea, [contenteditable]");
}

/** Whether the space bar ticks it. */
export function isTickBox(target: EventTarget | null): boolean {
  return matches(target, "input[type=checkbox], input[type=radio]");
}

/** Whether arrow keys move it. */
export function isSlider(target: EventTarget | null): boolean {
  return matches(target, "input[type=range]");
}

function matches(target: EventTarget | null, selector: string): boolean {
  return target instanceof HTMLElement && target.matches(selector);
}
