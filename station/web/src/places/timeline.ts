// Where the robot was in the last minutes.
import { call } from "../link/api";
import type { VisitModel } from "../link/messages";
import { by, make, show } from "../ui/dom";
import { clock } from "../ui/text";
import { colourOf } from "./colours";
import { placeInWords } from "./words";

const TIMELINE_S = 180;

export class Timeline {
  private visits: VisitModel[] = [];
  /** Of the places, by their id. */
  colours = new Map<string, number>();

  constructor() {
    setInterval(() => this.draw(), 1000);
  }

  /** The visits before now; those that events told while the answer came are newer than the answer. */
  async reload(): Promise<void> {
    this.visits = [];
    const earlier = await call<VisitModel[]>("GET", "/place/timeline");
    const known = new Set(this.visits.map((v) => v.start_unix_s));
    this.visits = [...earlier.filter((v) => !known.has(v.start_unix_s)), ...this.visits];
    this.visits.sort((a, b) => a.start_unix_s - b.start_unix_s);
    this.draw();
  }

  /** The newest visit, or the same one as before, which has gone on. */
  add(visit: VisitModel): void {
    if (this.visits.at(-1)?.start_unix_s === visit.start_unix_s) this.visits[this.visits.length - 1] = visit;
    else this.visits.push(visit);
  }

  private draw(): void {
    const now = Date.now() / 1000;
    const from = now - TIMELINE_S;
    const line = by("timeline");
    const recent = this.visits.filter((v) => v.end_unix_s > from);
    line.setAttribute("aria-label", `Places visited: ${recent.map(nameOf).join(", ") || "none"}`);
    line.replaceChildren(
      ...recent.map((v) => {
        const left = Math.max(0, (v.start_unix_s - from) / TIMELINE_S);
        const width = Math.max(0.004, (Math.min(v.end_unix_s, now) - Math.max(v.start_unix_s, from)) / TIMELINE_S);
        const name = nameOf(v);
        const piece = make(
          "span",
          { class: v.state, title: `${name}, since ${clock(v.start_unix_s)}` },
          width > 0.05 ? name : "",
        );
        piece.style.left = `${left * 100}%`;
        piece.style.width = `${width * 100}%`;
        const colour = v.place ? this.colours.get(v.place.id) : undefined;
        if (colour !== undefined) piece.style.setProperty("--own", colourOf(colour));
        return piece;
      }),
    );
    show(line, recent.length > 0);
  }
}

/** The place, or the room where the nearest place is another room's. */
function nameOf(visit: VisitModel): string {
  const { room, state } = visit;
  const words = placeInWords(visit, room ? [room] : []);
  return words ?? room?.name ?? state;
}
