// The robot on the plan: where it is, which way it faces, and how sure that is.
import type { CurrentPlace, FloorPlanModel } from "../link/messages";
import type { Fit } from "./fit";
import { draw } from "./svg";

const SURE = 2; // sigmas that the disc around it shows: 86 % of where it may be

/** Nothing while its position in this map is not known; of an answer that is withheld only where it would be. */
export function drawRobot(place: CurrentPlace | null, plan: FloorPlanModel, fit: Fit): SVGElement[] {
  if (!place?.position_map || place.map !== plan.map) return [];
  const [x, y] = fit.toScreen(onPlan(plan, place.position_map));
  const sigma = (place.sigma_position_m ?? 0) * plan.unit;
  const kind = place.withheld ? "withheld" : place.state;
  const robot = draw("g", { class: `plan-robot ${kind}`, transform: `translate(${x} ${y})` });
  robot.append(draw("circle", { class: "around", r: Math.max(fit.length(SURE * sigma), place.withheld ? 24 : 12) }));
  if (place.withheld) {
    robot.append(draw("text", { y: 6 }, "?"));
    return [robot];
  }
  if (place.forward_map) {
    const ahead = fit.toScreen(
      onPlan(
        plan,
        place.position_map.map((p, i) => p + (place.forward_map?.[i] ?? 0)),
      ),
    );
    const angle = (Math.atan2(ahead[1] - y, ahead[0] - x) * 180) / Math.PI;
    robot.append(draw("path", { class: "heading", d: "M17 0L3 -7.5L3 7.5Z", transform: `rotate(${angle})` }));
  }
  robot.append(draw("circle", { class: "body", r: 7.5 }));
  return [robot];
}

/** A position or direction of the map, on the plan. */
function onPlan(plan: FloorPlanModel, p: number[]): number[] {
  return plan.R_ground_map.slice(0, 2).map((row) => row.reduce((sum, r, i) => sum + r * (p[i] ?? 0), 0));
}
