// The floor plan of the map in use: what one looks at first, with the robot in it.
import { call, edit } from "../link/api";
import type { CurrentPlace, DoorModel, FloorPlanModel, PlaceModel, PlanRoom } from "../link/messages";
import { Refresh } from "../link/refresh";
import { undoablePlan } from "../places/changes";
import { by, make, setText, show } from "../ui/dom";
import { count } from "../ui/text";
import { attempt, toast } from "../ui/toast";
import { DoorPen } from "./door_pen";
import { drawPlan } from "./drawing";
import { Fit } from "./fit";
import { listenTo } from "./pressing";
import { drawRobot } from "./robot";
import { openRoom } from "./room_dialog";
import { draw, type Point, withData } from "./svg";

/** What a drawing was made of. */
interface Drawn {
  plan: FloorPlanModel;
  width: number;
  height: number;
}

export class PlanView {
  private readonly host = by("plan");
  private readonly svg = draw("svg", { "aria-label": "Floor plan", role: "group" });
  private readonly moving = draw("g", { class: "plan-moving" });
  private readonly card = by("plan-card");
  private readonly button = by("draw-door");
  private readonly content = new Refresh(() => this.fetch());
  private readonly pen = new DoorPen(
    this.svg,
    () => this.fit,
    (line) => this.drawDoor(line),
  );
  private wanted: string | null = null;
  private plan: FloorPlanModel | null = null;
  private fit: Fit | null = null;
  private drawn: Drawn | null = null;
  private place: CurrentPlace | null = null;

  /** `onPlace`: a place was clicked. */
  constructor(private readonly onPlace: (place: PlaceModel) => void) {
    this.host.prepend(this.svg);
    listenTo(this.host, { onPress: (part) => this.press(part), onHover: (part) => this.hover(part) });
    this.button.addEventListener("click", () => this.takePen(!this.pen.isOut));
    new ResizeObserver(() => this.draw()).observe(this.host);
    document.addEventListener("keydown", (event) => {
      if (event.key === "Escape") this.takePen(false);
    });
  }

  /** Whether the map in use has one. */
  get hasPlan(): boolean {
    return this.wanted !== null;
  }

  get summary(): string {
    return this.plan ? `${count(this.plan.rooms.length, "room")} · ${count(this.plan.places.length, "place")}` : "";
  }

  setVisible(visible: boolean): void {
    show(this.host, visible);
    show(this.button, visible);
    if (!visible) this.takePen(false);
  }

  /** Read it again: of another map, or changed; null: the map in use has none. */
  showMap(id: string | null): Promise<void> {
    this.wanted = id;
    if (id !== null) return this.content.ask();
    this.plan = null;
    this.draw();
    return Promise.resolve();
  }

  showPlace(place: CurrentPlace): void {
    this.place = place;
    this.drawMoving();
  }

  private async fetch(): Promise<void> {
    const wanted = this.wanted;
    if (wanted === null) return;
    const plan = await call<FloorPlanModel>("GET", "/floorplan");
    if (this.wanted !== wanted || plan.map !== wanted) return; // another map was chosen, and its event is on the way
    this.plan = plan;
    this.draw();
  }

  /** Where it is seen, and unless it is drawn like that already. */
  private draw(): void {
    const { plan, drawn } = this;
    const { clientWidth: width, clientHeight: height } = this.host;
    if (!plan) this.clear();
    if (!plan || !width || !height) return;
    if (drawn?.plan === plan && drawn.width === width && drawn.height === height) return;
    const focused = this.focusedPart();
    this.drawn = { plan, width, height };
    this.fit = new Fit(plan, width, height);
    this.svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
    this.hover(null);
    this.svg.replaceChildren(drawPlan(plan, this.fit, height), this.moving);
    if (focused) this.svg.querySelector<SVGElement>(focused)?.focus();
    setText(by("plan-count"), this.summary);
    for (const file of by("plan-files").querySelectorAll("a"))
      file.download = `${plan.map}.${file.dataset.ending ?? ""}`;
    this.hint();
    this.drawMoving();
  }

  private clear(): void {
    this.svg.replaceChildren();
    this.fit = this.drawn = null;
  }

  /** A selector of what has the keyboard's focus: a new drawing has other elements. */
  private focusedPart(): string | null {
    const part = this.svg.querySelector<SVGElement>(":focus");
    const name = ["room", "door", "dot"].find((kind) => part?.dataset[kind] !== undefined);
    return part && name ? `[role=button]${withData(name, part.dataset[name] ?? "")}` : null;
  }

  private drawMoving(): void {
    if (!this.plan || !this.fit) return;
    this.moving.replaceChildren(...drawRobot(this.place, this.plan, this.fit));
    this.mark("room", this.place?.room?.id ?? null);
    this.mark("dot", this.place?.place?.id ?? null);
  }

  /** Where the robot is: this one alone. */
  private mark(kind: "room" | "dot", id: string | null): void {
    const here = id === null ? [] : [...this.svg.querySelectorAll<SVGElement>(withData(kind, id))];
    for (const node of this.svg.querySelectorAll<SVGElement>(`.here[data-${kind}]`))
      if (!here.includes(node)) node.classList.remove("here");
    for (const node of here) node.classList.add("here");
  }

  private press(part: SVGElement): void {
    const { plan } = this;
    if (!plan) return;
    const { room, door, dot } = part.dataset;
    const named = plan.rooms.find(({ id }) => id === room);
    if (named) attempt(() => this.openRoom(named, plan));
    if (dot !== undefined) attempt(() => this.openPlace(dot));
    const pressed = plan.doors.find(({ id }) => id === door);
    if (pressed) this.askDoor(pressed);
  }

  private hover(part: SVGElement | null): void {
    const place = this.plan?.places.find(({ id }) => id === part?.dataset.dot);
    show(this.card, place !== undefined);
    if (!place || !this.fit) return;
    const [x, y] = this.fit.toScreen(place.at);
    const picture = place.representative_image;
    this.card.replaceChildren(
      ...(picture ? [make("img", { src: picture, alt: "" })] : []),
      make("span", {}, place.name),
    );
    const { clientWidth: width, clientHeight: height } = this.host;
    this.card.style.left = `${Math.min(Math.max(x, 90), width - 90)}px`;
    this.card.style.top = `${y}px`;
    this.card.classList.toggle("below", y < height / 2);
  }

  /** Afterwards the room has the keyboard's focus: by then the plan may be drawn anew, with other elements. */
  private openRoom(room: PlanRoom, plan: FloorPlanModel): Promise<void> {
    const focus = () =>
      this.svg.querySelector<SVGElement>(`[role=button]${withData("room", room.id)}`)?.focus({ preventScroll: true });
    by("room-dialog").addEventListener("close", focus, { once: true });
    return openRoom(room, plan);
  }

  private async openPlace(id: string): Promise<void> {
    this.onPlace(await call<PlaceModel>("GET", `/places/${id}`));
  }

  private askDoor(door: DoorModel): void {
    const erase = {
      label: "Erase",
      act: () => undoablePlan(() => edit("DELETE", `/doors/${encodeURIComponent(door.id)}`)),
    };
    const [a, b] = door.rooms.map((id) => this.plan?.rooms.find((room) => room.id === id)?.name);
    if (!a || !b) {
      toast(
        "Nobody went through this door when the map was made: the map ends here. Erase it where there is none.",
        erase,
      );
      return;
    }
    toast(`Door between ${a} and ${b}.`, erase);
  }

  private takePen(isOut: boolean): void {
    this.pen.take(isOut);
    setText(this.button, isOut ? "Cancel" : "Draw a door"); // a phone has no Esc
    this.hint();
  }

  /** What can be done here, until it is done. */
  private hint(): void {
    const isUnnamed = this.plan?.rooms.some(({ named }) => !named) ?? false;
    show(by("pen-hint"), this.pen.isOut);
    show(by("name-hint"), isUnnamed && !this.pen.isOut);
  }

  private drawDoor(line: [Point, Point]): void {
    this.takePen(false);
    attempt(() => undoablePlan(() => edit("POST", "/rooms/split", { line })));
  }
}
