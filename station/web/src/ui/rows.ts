// Lists whose rows stay the same elements while what they tell of changes: a click that began on a button ends on it, and the
// keyboard stays where it is.
import { make } from "./dom";

interface Row<T> {
  item: T;
  node: HTMLElement;
}

export class Rows<T> {
  private rows = new Map<string, Row<T>>();

  /**
   * `draw` makes a row. Its buttons act on `now()`, the newest state of what the row tells of; those that mean another
   * thing than the one drawn before at their place have another name (`data-act`).
   */
  constructor(
    private readonly list: HTMLElement,
    private readonly key: (item: T) => string,
    private readonly draw: (item: T, now: () => T) => HTMLElement,
  ) {}

  show(items: T[]): void {
    const wanted = new Set(items.map(this.key));
    for (const [key, row] of this.rows)
      if (!wanted.has(key)) {
        row.node.remove();
        this.rows.delete(key);
      }
    let before: Element | null = this.list.firstElementChild;
    for (const item of items) {
      const row = this.row(item);
      if (row.node === before) before = before.nextElementSibling;
      else this.list.insertBefore(row.node, before);
    }
  }

  private row(item: T): Row<T> {
    const key = this.key(item);
    const known = this.rows.get(key);
    const row = known ?? { item, node: this.list };
    row.item = item;
    const drawn = this.draw(item, () => row.item);
    if (known) renew(known.node, drawn);
    else row.node = drawn;
    this.rows.set(key, row);
    return row;
  }
}

/** A button of a row. */
export function action(act: string, text: string, label: string, run: () => void, kind = ""): HTMLElement {
  const names = { type: "button", class: `small ${kind}`.trim(), "data-act": act, onclick: run };
  return make("button", label ? { ...names, "aria-label": label } : names, text);
}

/** Make an element look as another one does, with as few new elements as can be. */
function renew(old: Element, fresh: Element): void {
  for (const { name } of [...old.attributes]) if (!fresh.hasAttribute(name)) old.removeAttribute(name);
  for (const { name, value } of [...fresh.attributes])
    if (old.getAttribute(name) !== value) old.setAttribute(name, value);
  let before: ChildNode | null = old.firstChild;
  for (const wanted of [...fresh.childNodes]) {
    let same: ChildNode | null = before;
    while (same && !isSame(same, wanted)) same = same.nextSibling;
    if (!same) {
      old.insertBefore(wanted, before);
      continue;
    }
    while (before && before !== same) before = remove(before);
    if (same instanceof Element) renew(same, wanted as Element);
    else if (same.nodeValue !== wanted.nodeValue) same.nodeValue = wanted.nodeValue;
    before = same.nextSibling;
  }
  while (before) before = remove(before);
}

function remove(node: ChildNode): ChildNode | null {
  const next = node.nextSibling;
  node.remove();
  return next;
}

function isSame(a: ChildNode, b: ChildNode): boolean {
  if (a.nodeName !== b.nodeName) return false;
  return !(a instanceof HTMLElement) || a.dataset.act === (b as HTMLElement).dataset.act;
}
