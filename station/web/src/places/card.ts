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

export class PlaceView {
  private readonly timeline = new Timeline();
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
    setText(by("place-name"), room ?? place.place?.name ?? otherwise);
    card.dataset.room = String(place.room !== null);
    const at = by("place-at");
    show(at, room !== null);
    setText(at, placeOrRooms(place) ?? otherwise);
    const shown = place.room?.probability ?? (place.place ? place.probability : place.preparing);
    setText(by("place-probability"), shown === null ? "" : percent(shown));
    setText(
      by("place-kicker"),
      place.doorway !== null
        ? "In the doorway"
        : place.place && place.distance_m !== null
          ? `${room === null ? "Current place" : "Current room and place"} · ${place.distance_m.toFixed(1)} m away`
          : room === null
            ? "Current place"
            : place.room === null
              ? "One of two rooms"
              : "Current room",
    );
    setText(by("place-reason"), place.reason);
    by("place-reason").title = place.reason;
    const preparing = by("preparing", HTMLProgressElement);
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
    if (visit) this.timeline.add(visit);
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
function roomInWords({ room, room_alternatives: others, one_of_two: two, doorway }: CurrentPlace): string | null {
  if (room) return doorway !== null && others[0] ? `${room.name} / ${others[0].name}` : room.name;
  return two.length ? two.map((one) => one.name).join(" or ") : null;
}

/** Below the room: the place, or how probable each of two rooms is; null: neither is known. */
function placeOrRooms(current: CurrentPlace): string | null {
  const { place, probability, one_of_two: two } = current;
  if (place) return `${placeInWords(current, place.name)}, ${percent(probability)}`;
  return two.length ? two.map((one) => `${one.name} ${percent(one.probability)}`).join(", ") : null;
}

/** The nearest place; "near" it where the robot is in another room than the one that it is called after. */
function placeInWords({ room, doorway }: CurrentPlace, name: string): string {
  const [ofRoom, which] = name.split(" · ");
  return room && doorway === null && which !== undefined && ofRoom !== room.name ? `near ${name}` : name;
}

function setImage(image: HTMLImageElement, path: string | null): void {
  show(image, path !== null);
  if (path !== null && image.getAttribute("src") !== path) image.src = path;
}
