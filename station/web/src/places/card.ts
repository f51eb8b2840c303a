// The current place in large letters, why, and where the robot was before.
import { call } from "../link/api";
import type { CurrentPlace, PlaceChange, PlaceModel, PlacesChangeModel, VisitModel } from "../link/messages";
import { askUntil } from "../ui/dialogs";
import { by, make, present, setText, show } from "../ui/dom";
import { action, Rows } from "../ui/rows";
import { clock, count, duration, percent } from "../ui/text";
import { attempt, toast } from "../ui/toast";
import { colourOf } from "./colours";

const TIMELINE_S = 180;

export class PlaceView {
  private visits: VisitModel[] = [];
  private places: PlaceModel[] = [];
  private colours = new Map<string, number>();
  private current: string | null = null;
  private readonly hiddenRows = new Rows<PlaceModel>(
    by("hidden-places"),
    (p) => p.id,
    (place, now) => {
      const again = () => attempt(() => change(now(), { hidden: false }));
      return make("li", {}, make("span", {}, place.name), action("show", "Show", `Show ${place.name} again`, again));
    },
  );

  constructor() {
    setInterval(() => this.drawTimeline(), 1000);
  }

  /** The visits before now; those that events told while the answer came are newer than the answer. */
  async reload(): Promise<void> {
    this.visits = [];
    const earlier = await call<VisitModel[]>("GET", "/place/timeline");
    const known = new Set(this.visits.map((v) => v.start_unix_s));
    this.visits = [...earlier.filter((v) => !known.has(v.start_unix_s)), ...this.visits];
    this.visits.sort((a, b) => a.start_unix_s - b.start_unix_s);
    this.drawTimeline();
  }

  /** The places of the map in use, hidden ones too, and what people made of them. */
  setPlaces(places: PlaceModel[], changes: PlacesChangeModel[]): void {
    this.places = places;
    const [last] = changes;
    show(by("undo"), last !== undefined);
    if (last) {
      setText(by("undo-text"), last.why);
      by("undo-places").onclick = () => attempt(() => undo(last));
    }
    this.colours = new Map(places.map((p) => [p.id, p.colour]));
    this.showColour();
    const hidden = places.filter((p) => p.hidden);
    show(by("hidden"), hidden.length > 0);
    this.hiddenRows.show(hidden);
  }

  /** Everything known of one place, and what can be made of it. */
  open(place: PlaceModel): void {
    const dialog = by<HTMLDialogElement>("place-dialog");
    const others = this.places.filter((p) => p.id !== place.id && !p.hidden);
    const picture = (path: string | null, text: string) =>
      path &&
      make(
        "figure",
        {},
        make("img", { src: path, alt: `${text} picture of ${place.name}` }),
        make("figcaption", {}, text),
      );
    const button = (text: string, act: () => Promise<unknown>, kind = "") =>
      make(
        "button",
        {
          type: "button",
          class: kind,
          autofocus: kind === "primary",
          onclick: () => {
            dialog.close();
            attempt(act);
          },
        },
        text,
      );
    const rename = async () => {
      let changed = false;
      const save = async (name: string) => {
        if (name === place.name) return;
        await change(place, { name });
        changed = true;
      };
      await askUntil("Name this place", "Save", { label: "Name", value: place.name }, save);
      if (changed) await offerUndo();
    };
    const hide = () => undoable(() => change(place, { hidden: true }));
    const nobody = make("option", { value: "", selected: true }, "choose a place");
    const select = make(
      "select",
      { id: "merge-with" },
      nobody,
      ...others.map((p) => make("option", { value: p.id }, p.name)),
    );
    const merge = button("Merge", () =>
      undoable(() => call("POST", "/places/merge", { places: [place.id, select.value] })),
    );
    merge.disabled = true;
    select.addEventListener("change", () => (merge.disabled = !select.value));
    dialog.replaceChildren(
      ...present(
        make("h2", {}, place.name),
        make(
          "div",
          { class: "evidence three" },
          picture(place.representative_image, "representative"),
          picture(place.mean_image, "mean"),
          picture(place.deviation_image, "deviation"),
        ),
        make(
          "p",
          { class: "note" },
          `${count(place.landmarks, "landmark")} · seen in ${count(place.images, "picture")} · quality ${percent(place.quality)}`,
        ),
        others.length > 0 &&
          make("div", { class: "row merge" }, make("label", { for: "merge-with" }, "Same place as"), select, merge),
        make(
          "div",
          { class: "row end" },
          button("Close", async () => {}, "quiet apart"),
          button("Hide", hide),
          button("Rename", rename, "primary"),
        ),
      ),
    );
    dialog.showModal();
  }

  show(place: CurrentPlace, visit: VisitModel | null): void {
    const card = by("place");
    const hasAnswer = place.t_robot_ns !== null;
    card.dataset["state"] = place.map === null ? "none" : hasAnswer ? place.state : "waiting";
    const words = { known: "", unknown: "Unknown place", lost: "Where am I?" };
    const otherwise = place.map === null ? "No map in use" : hasAnswer ? words[place.state] : "Getting ready…";
    setText(by("place-name"), place.place?.name ?? otherwise);
    const shown = place.place ? place.probability : place.preparing;
    setText(by("place-probability"), shown === null ? "" : percent(shown));
    setText(
      by("place-kicker"),
      place.place && place.distance_m !== null
        ? `Current place · ${place.distance_m.toFixed(1)} m away`
        : "Current place",
    );
    setText(by("place-reason"), place.reason);
    by("place-reason").title = place.reason;
    const preparing = by<HTMLProgressElement>("preparing");
    show(preparing, place.preparing !== null);
    if (place.preparing !== null) preparing.value = place.preparing;
    this.current = place.place?.id ?? null;
    this.showColour();
    by("alternatives").replaceChildren(
      ...place.alternatives
        .filter((a) => a.probability >= 0.01)
        .slice(0, 3)
        .map((a) => {
          const bar = make("span", { class: "meter" });
          bar.style.setProperty("--share", String(a.probability));
          return make("li", {}, a.name, bar, make("span", { class: "number" }, percent(a.probability)));
        }),
    );
    this.showEvidence(place);
    if (visit) {
      const last = this.visits.at(-1);
      if (last && last.start_unix_s === visit.start_unix_s) this.visits[this.visits.length - 1] = visit;
      else this.visits.push(visit);
    }
  }

  /** Answers and the places they name come one by one: whichever is later shows the colour. */
  private showColour(): void {
    const colour = this.current === null ? undefined : this.colours.get(this.current);
    by("place").style.setProperty("--own", colour === undefined ? "transparent" : colourOf(colour));
  }

  private showEvidence(place: CurrentPlace): void {
    const { query_image, map_image, inliers, age_s } = place.evidence;
    setImage(by<HTMLImageElement>("query"), query_image);
    setImage(by<HTMLImageElement>("match"), map_image);
    show(by("evidence"), Boolean(query_image && map_image));
    // What was recognised once does not tell where the robot is now: the answer says whether it does.
    const seen =
      `${count(inliers, "landmark")} of the map seen where they belong` +
      (age_s === null ? "" : `, ${duration(age_s)} ago`);
    const isNow = place.state === "known";
    setText(
      by("evidence-text"),
      !map_image
        ? "No picture was recognised yet."
        : isNow
          ? seen
          : `The last picture that was recognised: ${seen}. It does not tell where the robot is now.`,
    );
  }

  private drawTimeline(): void {
    const now = Date.now() / 1000;
    const from = now - TIMELINE_S;
    const line = by("timeline");
    const recent = this.visits.filter((v) => v.end_unix_s > from);
    line.setAttribute(
      "aria-label",
      `Places visited: ${recent.map((v) => v.place?.name ?? v.state).join(", ") || "none"}`,
    );
    line.replaceChildren(
      ...recent.map((v) => {
        const left = Math.max(0, (v.start_unix_s - from) / TIMELINE_S);
        const width = Math.max(0.004, (Math.min(v.end_unix_s, now) - Math.max(v.start_unix_s, from)) / TIMELINE_S);
        const name = v.place?.name ?? v.state;
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

function setImage(image: HTMLImageElement, path: string | null): void {
  show(image, path !== null);
  if (path !== null && image.getAttribute("src") !== path) image.src = path;
}

/** Do it, and offer for a while to take just that back; later there is the list of navigations and maps. */
async function undoable(work: () => Promise<unknown>): Promise<void> {
  await work();
  await offerUndo();
}

async function offerUndo(): Promise<void> {
  const [made] = await call<PlacesChangeModel[]>("GET", "/places/changes");
  if (made) toast(`${made.why}.`, "Undo", () => undo(made));
}

function undo(made: PlacesChangeModel): Promise<unknown> {
  return call("POST", "/places/undo", { version: made.version });
}

function change(place: PlaceModel, what: Partial<PlaceChange>): Promise<PlaceModel> {
  return call("PATCH", `/places/${place.id}`, what);
}
