// The floor plan as a drawing: rooms, walls, doors, places, and what lies over them.
import type { DoorModel, FloorPlanModel, PlanPlace, PlanRoom } from "../link/messages";
import { colourOf } from "../places/colours";
import { context2d } from "../ui/dom";
import type { Fit } from "./fit";
import { closedPath, draw } from "./svg";

const NAME_FONT = "620 15px"; // of a room's name, as in style.css
const HERE = 18 / 15; // so much larger is the name of the room where the robot is
const NAME_EDGE_PX = 4; // between a name and the walls beside it
const LEAST_LETTERS = 5; // of fewer nobody knows what they begin
const DOT_PX = 6; // radius
const LEAST_DOOR_PX = 6; // a narrower one is drawn, but nobody would hit it: its rooms' dialogs make them one
const WALL_PX = { widest: 5, narrowest: 1.2, metres: 0.2 }; // on a large plan walls leave space for rooms
const ruler = context2d(document.createElement("canvas"));
const SCALE_BARS_M = [0.5, 1, 2, 5, 10, 20];

/** Everything of the plan that does not move. What can be pressed says by its data which room, door or dot it is. */
export function drawPlan(plan: FloorPlanModel, fit: Fit, height: number): SVGGElement {
  const [leading, leaving] = [plan.doors.filter((door) => !leaves(door)), plan.doors.filter(leaves)];
  const isPressable = (door: DoorModel) => fit.length(door.width) >= LEAST_DOOR_PX;
  const drawing = draw(
    "g",
    {},
    draw("g", { class: "plan-rooms" }, ...plan.rooms.map((room, i) => drawRoom(room, i, fit))),
    draw("path", { class: "plan-path", d: openPath(plan.path, fit) }),
    draw("path", { class: "plan-walls", d: plan.walls.map((wall) => openPath(wall, fit)).join("") }),
    draw("path", { class: "plan-gaps", d: gaps(plan.doors, fit) }),
    draw("path", { class: "plan-sills", d: gaps(leading, fit) }),
    draw("path", { class: "plan-sills leaving", d: gaps(leaving, fit) }),
    draw("g", {}, ...plan.doors.filter(isPressable).map((door) => drawDoor(door, plan, fit))),
    draw("g", { class: "plan-places" }, ...shown(plan, fit).map((place) => drawPlace(place, fit))),
    draw("g", { class: "plan-names" }, ...plan.rooms.flatMap((room) => drawName(room, fit))),
    ...(plan.metric ? [drawScale(fit, height)] : []),
  );
  const wall = Math.max(WALL_PX.narrowest, Math.min(WALL_PX.widest, fit.length(WALL_PX.metres * plan.unit)));
  drawing.style.setProperty("--wall", String(wall));
  return drawing;
}

function drawRoom(room: PlanRoom, number: number, fit: Fit): SVGElement {
  const path = draw("path", {
    class: "plan-room",
    d: room.outline.map((ring) => closedPath(ring.map((at) => fit.toScreen(at)))).join(""),
    "data-room": room.id,
    ...pressable(room.named ? room.name : `${room.name}: click to name it`),
  });
  path.style.setProperty("--own", colourOf(5 * number)); // five steps on the wheel: neighbours in the list differ
  return path;
}

function drawName(room: PlanRoom, fit: Fit): SVGElement[] {
  const [middle, y] = fit.toScreen(room.middle);
  const across = room.outline.flat().map((at) => fit.toScreen(at)[0]);
  const [left, right] = [Math.min(...across, middle), Math.max(...across, middle)];
  const space = right - left - 2 * NAME_EDGE_PX;
  const name = cut(room.name, space);
  if (name === null) return [];
  const width = widthOf(name);
  const half = Math.min(width / 2 + NAME_EDGE_PX, (right - left) / 2);
  const x = Math.min(Math.max(middle, left + half), right - half); // all of it within the room
  const text = draw("text", { x, y, "data-room": room.id }, name);
  if (!room.named) text.classList.add("unnamed");
  if (HERE * width > space) text.classList.add("tight");
  return [text];
}

/** As much of a name as there is space for; null: so little that nobody knows what it begins. */
function cut(name: string, space: number): string | null {
  const whole = widthOf(name);
  if (whole <= space) return name;
  const letters = Array.from(name);
  let kept = Math.floor((letters.length * Math.max(space, 0)) / whole);
  const beginning = () => `${letters.slice(0, kept).join("").trimEnd()}…`;
  while (kept >= LEAST_LETTERS - 1 && widthOf(beginning()) > space) kept -= 1;
  return kept < LEAST_LETTERS - 1 ? null : beginning();
}

function widthOf(name: string): number {
  ruler.font = `${NAME_FONT} ${getComputedStyle(document.body).fontFamily}`;
  return ruler.measureText(name).width;
}

/** Where a door can be pressed: wider than it is drawn, which the paths of all doors do. */
function drawDoor(door: DoorModel, plan: FloorPlanModel, fit: Fit): SVGElement {
  const names = door.rooms.map((id) => plan.rooms.find((room) => room.id === id)?.name ?? "what was not mapped");
  const width = plan.metric ? `, ${door.width.toFixed(1)} m wide` : "";
  const label = `Door between ${names.join(" and ")}${width}`;
  const d = openPath(door.ends, fit);
  return draw(
    "g",
    { class: `plan-door${leaves(door) ? " leaving" : ""}`, "data-door": door.id, ...pressable(label) },
    draw("path", { class: "sill", d }),
    draw("path", { class: "reach", d }),
  );
}

function leaves(door: DoorModel): boolean {
  return door.rooms.includes(null);
}

function gaps(doors: DoorModel[], fit: Fit): string {
  return doors.map((door) => openPath(door.ends, fit)).join("");
}

function drawPlace(place: PlanPlace, fit: Fit): SVGElement {
  const [cx, cy] = fit.toScreen(place.at);
  const dot = draw("circle", {
    class: "plan-place",
    cx,
    cy,
    r: DOT_PX,
    "data-dot": place.id,
    ...pressable(place.name),
  });
  dot.style.setProperty("--own", colourOf(place.colour));
  return dot;
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

/** Attributes of what mouse, touch and keyboard can press: see pressing.ts. */
function pressable(label: string): Record<string, string> {
  return { role: "button", tabindex: "0", "aria-label": label };
}

function openPath(points: number[][], fit: Fit): string {
  return points
    .map((at, i) => {
      const [x, y] = fit.toScreen(at);
      return `${i ? "L" : "M"}${x.toFixed(1)} ${y.toFixed(1)}`;
    })
    .join("");
}
