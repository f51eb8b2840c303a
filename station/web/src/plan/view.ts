// The floor plan of the map in use: what one looks at first, with the robot in it.
import { call } from "../link/api";
import type { CurrentPlace, DoorModel, FloorPlanModel, PlaceModel, PlanPlace } from "../link/messages";
import { Refresh } from "../link/refresh";
import { undoable } from "../places/changes";
import { by, make, setText, show } from "../ui/dom";
import { count } from "../ui/text";
import { attempt, toast } from "../ui/toast";
import { DoorPen } from "./door_pen";
import { drawPlan } from "./drawing";
import { Fit } from "./fit";
import { drawRobot } from "./robot";
import { openRoom } from "./room_dialog";
import { draw, type Point } from "./svg";

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
  private place: CurrentPlace | null = null;

  /** `onPlace`: a place was clicked. */
  constructor(private readonly onPlace: (place: PlaceModel) => void) {
    this.host.prepend(this.svg);
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

  private draw(): void {
    const { clientWidth: width, clientHeight: height } = this.host;
    if (!this.plan || !width || !height) {
      this.svg.replaceChildren();
      this.fit = null;
      return;
    }
    const { plan } = this;
    this.fit = new Fit(plan, width, height);
    this.svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
    this.hover(null, [0, 0]);
    const still = drawPlan(plan, this.fit, height, {
      onRoom: (room) => attempt(() => openRoom(room.id, plan)),
      onDoor: (door) => this.askDoor(door),
      onPlace: (place) => attempt(() => this.openPlace(place)),
      onHover: (place, at) => this.hover(place, at),
    });
    this.svg.replaceChildren(still, this.moving);
    setText(by("plan-count"), this.summary);
    this.drawMoving();
  }

  private drawMoving(): void {
    if (!this.plan || !this.fit) return;
    this.moving.replaceChildren(...drawRobot(this.place, this.plan, this.fit));
    const room = this.place?.room?.id;
    const place = this.place?.place?.id;
    for (const node of this.svg.querySelectorAll<SVGElement>("[data-room]"))
      node.classList.toggle("here", node.dataset.room === room);
    for (const node of this.svg.querySelectorAll<SVGElement>("[data-dot]"))
      node.classList.toggle("here", node.dataset.dot === place);
  }

  private hover(place: PlanPlace | null, [x, y]: Point): void {
    show(this.card, place !== null);
    if (!place) return;
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

  private async openPlace(place: PlanPlace): Promise<void> {
    this.onPlace(await call<PlaceModel>("GET", `/places/${place.id}`));
  }

  private askDoor(door: DoorModel): void {
    const [a, b] = door.rooms.map((id) => this.plan?.rooms.find((room) => room.id === id)?.name);
    if (!a || !b) {
      toast("Nobody went through this door when the map was made: what is behind it is not mapped.");
      return;
    }
    toast(`Door between ${a} and ${b}.`, {
      label: "Erase",
      act: () => undoable(() => call("DELETE", `/doors/${encodeURIComponent(door.id)}`)),
    });
  }

  private takePen(isOut: boolean): void {
    this.pen.take(isOut);
    this.button.setAttribute("aria-pressed", String(isOut));
    show(by("pen-hint"), isOut);
  }

  private drawDoor(line: [Point, Point]): void {
    this.takePen(false);
    attempt(() => undoable(() => call("POST", "/rooms/split", { line })));
  }
}
