// The floor plan as a drawing: rooms, walls, doors, places, and what lies over them.
import type { DoorModel, FloorPlanModel, PlanPlace, PlanRoom } from "../link/messages";
import { colourOf } from "../places/colours";
import type { Fit } from "./fit";
import { closedPath, draw, type Point } from "./svg";

export interface DrawingEvents {
  onRoom: (room: PlanRoom) => void;
  onDoor: (door: DoorModel) => void;
  onPlace: (place: PlanPlace) => void;
  /** The pointer is over a place, or its keyboard focus is; null: over none any more. */
  onHover: (place: PlanPlace | null, at: Point) => void;
}

const NAME_PX = 8.2; // width of a letter of a room's name
const LEAST_LETTERS = 5; // of fewer nobody knows what they begin
const DOT_PX = 6; // radius
const SCALE_BARS_M = [0.5, 1, 2, 5, 10, 20];

/** Everything of the plan that does not move. */
export function drawPlan(plan: FloorPlanModel, fit: Fit, height: number, events: DrawingEvents): SVGGElement {
  return draw(
    "g",
    {},
    draw("g", { class: "plan-rooms" }, ...plan.rooms.map((room, i) => drawRoom(room, i, fit, events))),
    draw("path", { class: "plan-path", d: openPath(plan.path, fit) }),
    draw("path", { class: "plan-walls", d: plan.walls.map((wall) => openPath(wall, fit)).join("") }),
    draw("g", { class: "plan-doors" }, ...plan.doors.map((door) => drawDoor(door, plan, fit, events))),
    draw("g", { class: "plan-places" }, ...shown(plan, fit).map((place) => drawPlace(place, fit, events))),
    draw("g", { class: "plan-names" }, ...plan.rooms.flatMap((room) => drawName(room, fit))),
    ...(plan.metric ? [drawScale(fit, height)] : []),
  );
}

function drawRoom(room: PlanRoom, number: number, fit: Fit, { onRoom }: DrawingEvents): SVGElement {
  const path = draw("path", {
    class: "plan-room",
    d: room.outline.map((ring) => closedPath(ring.map((at) => fit.toScreen(at)))).join(""),
    "fill-rule": "evenodd",
    "data-room": room.id,
  });
  path.style.setProperty("--own", colourOf(5 * number)); // five steps on the wheel: neighbours in the list differ
  return pressable(path, room.named ? room.name : `${room.name}: click to name it`, () => onRoom(room));
}

function drawName(room: PlanRoom, fit: Fit): SVGElement[] {
  const [x, y] = fit.toScreen(room.middle);
  const across = room.outline.flat().map((at) => fit.toScreen(at)[0]);
  const space = Math.max(...across, x) - Math.min(...across, x);
  const letters = Math.floor(space / NAME_PX);
  if (letters < Math.min(room.name.length, LEAST_LETTERS)) return [];
  const name = room.name.length > letters ? `${room.name.slice(0, Math.max(letters - 1, 1))}…` : room.name;
  const text = draw("text", { x, y, "data-room": room.id }, name);
  if (!room.named) text.classList.add("unnamed");
  return [text];
}

function drawDoor(door: DoorModel, plan: FloorPlanModel, fit: Fit, { onDoor }: DrawingEvents): SVGElement {
  const names = door.rooms.map((id) => plan.rooms.find((room) => room.id === id)?.name ?? "what was not mapped");
  const group = draw(
    "g",
    { class: `plan-door${door.drawn ? " drawn" : ""}${door.rooms.includes(null) ? " leaves" : ""}` },
    line(door.ends, fit, { class: "gap" }),
    line(door.ends, fit, { class: "sill" }),
    line(door.ends, fit, { class: "reach" }),
  );
  const width = plan.metric ? `, ${door.width.toFixed(1)} m wide` : "";
  return pressable(group, `Door between ${names.join(" and ")}${width}`, () => onDoor(door));
}

function drawPlace(place: PlanPlace, fit: Fit, { onPlace, onHover }: DrawingEvents): SVGElement {
  const [x, y] = fit.toScreen(place.at);
  const dot = draw("circle", { class: "plan-place", cx: x, cy: y, r: DOT_PX, "data-dot": place.id });
  dot.style.setProperty("--own", colourOf(place.colour));
  for (const type of ["pointerenter", "focus"]) dot.addEventListener(type, () => onHover(place, [x, y]));
  for (const type of ["pointerleave", "blur"]) dot.addEventListener(type, () => onHover(null, [x, y]));
  return pressable(dot, place.name, () => onPlace(place));
}

/** None where a metre is smaller than a dot: they would cover their rooms. */
function shown(plan: FloorPlanModel, fit: Fit): PlanPlace[] {
  return fit.length(plan.unit) < 2 * DOT_PX ? [] : plan.places;
}

function drawScale(fit: Fit, height: number): SVGElement {
  const metres = SCALE_BARS_M.find((m) => fit.length(m) >= 60) ?? 50;
  const [x, y, px] = [14, height - 34, fit.length(metres)];
  return draw(
    "g",
    { class: "plan-scale" },
    draw("path", { d: `M${x} ${y - 4}v8M${x} ${y}h${px}M${x + px} ${y - 4}v8` }),
    draw("text", { x: x + px + 8, y: y + 4 }, `${metres} m`),
  );
}

/** By mouse, touch and keyboard. */
function pressable<T extends SVGElement>(node: T, label: string, press: () => void): T {
  node.setAttribute("role", "button");
  node.setAttribute("tabindex", "0");
  node.setAttribute("aria-label", label);
  node.append(draw("title", {}, label));
  node.addEventListener("click", press);
  node.addEventListener("keydown", (event) => {
    if (event.key !== "Enter" && event.key !== " ") return;
    event.preventDefault();
    press();
  });
  return node;
}

function line(ends: number[][], fit: Fit, attributes: Record<string, string>): SVGLineElement {
  const [[x1, y1], [x2, y2]] = [fit.toScreen(ends[0] ?? []), fit.toScreen(ends[1] ?? [])];
  return draw("line", { ...attributes, x1, y1, x2, y2 });
}

function openPath(points: number[][], fit: Fit): string {
  return points
    .map((at, i) => {
      const [x, y] = fit.toScreen(at);
      return `${i ? "L" : "M"}${x.toFixed(1)} ${y.toFixed(1)}`;
    })
    .join("");
}
