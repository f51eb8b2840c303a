// The current place in large letters, and why; the places of the map in use.
import type { CurrentPlace, PlaceModel, VisitModel } from "../link/messages";
import { by, make, setText, show } from "../ui/dom";
import { action, Rows } from "../ui/rows";
import { count, duration, percent } from "../ui/text";
import { attempt } from "../ui/toast";
import { change } from "./changes";
import { colourOf } from "./colours";
import { openPlace } from "./dialog";
import { Timeline } from "./timeline";
import { placeInWords, roomsOf } from "./words";

const LONG = 18; // letters of a name in large type that a line of a phone has space for

export class PlaceView {
  private readonly timeline = new Timeline();
  private readonly at = make("span", { id: "place-at-name" });
  private readonly atSure = make("span", { id: "place-at-sure" });
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
    by("place-at").append(this.at, this.atSure);
    const whole = by("place-whole"); // on a phone, where long sentences are cut
    whole.addEventListener("click", () => {
      whole.setAttribute("aria-expanded", String(by("place").toggleAttribute("data-whole")));
    });
  }

  /** The visits before now. */
  reload(): Promise<void> {
    return this.timeline.reload();
  }

  /** The places of the map in use, hidden ones too. */
  setPlaces(places: PlaceModel[]): void {
    this.places = places;
    this.colours = new Map(places.map((p) => [p.id, p.colour]));
    this.timeline.colours = this.colours;
    this.showColour();
    const hidden = places.filter((p) => p.hidden);
    show(by("hidden"), hidden.length > 0);
    this.hiddenRows.show(hidden);
  }

  /** Everything known of one place, and what can be made of it. */
  open(place: PlaceModel): void {
    openPlace(
      place,
      this.places.filter((p) => p.id !== place.id && !p.hidden),
    );
  }

  show(place: CurrentPlace, visit: VisitModel | null): void {
    const card = by("place");
    const hasAnswer = place.t_robot_ns !== null;
    card.dataset.state = place.map === null ? "none" : hasAnswer ? place.state : "waiting";
    const words = { known: "", unknown: "Unknown place", lost: "Where am I?" };
    const noAnswer =
      place.map === null ? "No map in use" : place.preparing === null ? "No answer yet" : "Getting ready…";
    const otherwise = hasAnswer && place.map !== null ? words[place.state] : noAnswer;
    const room = roomInWords(place);
    const name = room ?? place.place?.name ?? otherwise;
    setWithTitle(by("place-name"), name);
    by("place-name").classList.toggle("long", name.length > LONG);
    card.dataset.room = String(place.room !== null);
    this.showPlaceOf(place, room !== null);
    this.showProbability(place);
    setText(by("place-kicker"), kicker(place));
    setWithTitle(by("place-reason"), place.reason);
    const preparing = by("preparing", HTMLProgressElement);
    show(preparing, place.preparing !== null);
    if (place.preparing !== null) preparing.value = place.preparing;
    this.current = place.place?.id ?? null;
    this.showColour();
    this.showAlternatives(place);
    this.showEvidence(place);
    if (visit) this.timeline.add(visit);
  }

  /** Beneath its room: a long name is cut, its probability is not. */
  private showPlaceOf(place: CurrentPlace, hasRoom: boolean): void {
    const at = hasRoom ? placeOrRooms(place) : null;
    show(by("place-at"), at !== null);
    setWithTitle(this.at, at?.words ?? "");
    setText(this.atSure, at?.sure ?? "");
  }

  /** In large type, and of what it is: a room and its place are two questions, each with its own answer. */
  private showProbability({ room, place, probability, preparing }: CurrentPlace): void {
    const shown = room?.probability ?? (place ? probability : preparing);
    setText(by("place-probability"), shown === null ? "" : percent(shown));
    setText(by("place-probability-of"), shown === null ? "" : room ? "room" : place ? "place" : "ready");
  }

  /** Other places that it may be at; of an answer that is withheld they are as doubtful as the answer. */
  private showAlternatives({ place, probability, alternatives, withheld }: CurrentPlace): void {
    const likely = withheld ? [] : alternatives.filter((a) => a.probability >= 0.01).slice(0, 3);
    const shares = [...(place ? [probability] : []), ...likely.map((a) => a.probability)];
    const sum = shares.reduce((whole, share) => whole + Math.round(100 * share), 0);
    show(by("else"), likely.length > 0);
    setText(
      by("else-title"),
      (place ? "Perhaps as near" : "Nearest place, perhaps") +
        (sum > 100 ? " (between places several are right: together more than 100 %)" : ""),
    );
    by("alternatives").replaceChildren(
      ...likely.map((a) => {
        const bar = make("span", { class: "meter" });
        bar.style.setProperty("--share", String(a.probability));
        const name = make("span", { class: "name", title: a.name }, a.name);
        return make("li", {}, name, bar, make("span", { class: "number" }, percent(a.probability)));
      }),
    );
  }

  /** Answers and the places they name come one by one: whichever is later shows the colour. */
  private showColour(): void {
    const colour = this.current === null ? undefined : this.colours.get(this.current);
    by("place").style.setProperty("--own", colour === undefined ? "transparent" : colourOf(colour));
  }

  private showEvidence(place: CurrentPlace): void {
    const { query_image, map_image, inliers, age_s } = place.evidence;
    setImage(by("query", HTMLImageElement), query_image);
    setImage(by("match", HTMLImageElement), map_image);
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
}

/** The room in large letters: one, both of a doorway, or which two it may be; null: nothing is known of it. */
function roomInWords(current: CurrentPlace): string | null {
  const rooms = roomsOf(current);
  if (rooms.length) return rooms.map(({ name }) => name).join(" / ");
  const { one_of_two: two } = current;
  return two.length ? two.map((one) => one.name).join(" or ") : null;
}

/** Below the room: the place, or how probable each of two rooms is; null: the nearest place is another room's. */
function placeOrRooms(current: CurrentPlace): { words: string; sure: string } | null {
  const { place, probability, one_of_two: two } = current;
  if (!place && two.length) return { words: two.map((one) => percent(one.probability)).join(" or "), sure: "" };
  if (!place) return { words: "not sure at which place", sure: "" };
  const words = placeInWords(current, roomsOf(current));
  return words === null ? null : { words, sure: words === place.name ? `, ${percent(probability)}` : "" };
}

/** Above the name: what it is. */
function kicker(current: CurrentPlace): string {
  const { place, room, one_of_two: two, doorway, distance_m: distance } = current;
  if (doorway !== null) return "In the doorway";
  if (!room && two.length) return "One of two rooms";
  const isTold = place !== null && placeInWords(current, roomsOf(current)) === place.name;
  const what = room ? (isTold ? "Current room and place" : "Current room") : "Current place";
  return isTold && distance !== null ? `${what} · ${distance.toFixed(1)} m away` : what;
}

/** A text that may be cut, whole beside the pointer. */
function setWithTitle(node: HTMLElement, text: string): void {
  setText(node, text);
  node.title = text;
}

function setImage(image: HTMLImageElement, path: string | null): void {
  show(image, path !== null);
  if (path !== null && image.getAttribute("src") !== path) image.src = path;
}
