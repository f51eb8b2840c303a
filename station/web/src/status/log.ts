// What happened, the newest line first.
import type { LogModel } from "../link/messages";
import { by, make } from "../ui/dom";
import { clock } from "../ui/text";

const MAX_LINES = 100;

export class EventLog {
  private lines = new Map<number, LogModel>(); // by their number, newest first

  /** New lines, or old ones; a line that is shown already is not shown twice. */
  add(lines: LogModel[]): void {
    for (const line of lines) this.lines.set(line.number, line);
    const newest = [...this.lines.values()].sort((a, b) => b.number - a.number).slice(0, MAX_LINES);
    this.lines = new Map(newest.map((line) => [line.number, line]));
    const log = by("log");
    const shown = new Map([...log.children].map((item) => [Number((item as HTMLElement).dataset.number), item]));
    for (const [number, item] of shown) if (!this.lines.has(number)) item.remove();
    let before: Element | null = null; // the log is a live region: only what is new may be added to it
    for (const line of newest.reverse()) {
      const item: Element = shown.get(line.number) ?? logItem(line);
      if (!item.isConnected) log.insertBefore(item, before);
      before = item;
    }
  }

  /** Another station's lines, or the same one's since its start, are counted from 1 again. */
  clear(): void {
    this.lines.clear();
    by("log").replaceChildren();
  }
}

function logItem(line: LogModel): HTMLElement {
  const item = make("li", { class: line.level }, make("time", {}, clock(line.unix_s)), line.text);
  item.dataset.topic = line.topic;
  item.dataset.number = String(line.number);
  return item;
}
