// How the plan lies on the screen: as large as fits, turned by a quarter where it is then larger.
import type { FloorPlanModel } from "../link/messages";
import type { Point } from "./svg";

const MARGIN = 26; // pixels: names and dots at the edge are not cut
const HEAD = 36; // at the upper edge: what can be done
const FOOT = 50; // at the lower edge: the scale and how many rooms there are
const LARGEST = 220; // pixels a metre: a single room does not fill the panel with one wall

export class Fit {
  private readonly scale: number;
  private readonly isTurned: boolean;
  private readonly centre: Point; // on the plan
  private readonly middle: Point; // on the screen, of the same

  constructor(
    private readonly plan: FloorPlanModel,
    width: number,
    height: number,
  ) {
    const [w, h] = [this.size(0), this.size(1)];
    const [across, up] = [Math.max(width - 2 * MARGIN, 50), Math.max(height - HEAD - FOOT, 50)];
    const [straight, turned] = [Math.min(across / w, up / h), Math.min(across / h, up / w)];
    this.isTurned = turned > 1.15 * straight;
    this.scale = Math.min(this.isTurned ? turned : straight, LARGEST / plan.unit);
    this.middle = [width / 2, HEAD + up / 2];
    this.centre = [(low(plan, 0) + high(plan, 0)) / 2, (low(plan, 1) + high(plan, 1)) / 2];
  }

  /** Pixels of a length of the plan. */
  length(units: number): number {
    return units * this.scale;
  }

  toScreen(at: readonly number[]): Point {
    const [x, y] = [(at[0] ?? 0) - this.centre[0], (at[1] ?? 0) - this.centre[1]];
    const [right, up] = this.isTurned ? [y, -x] : [x, y];
    return [this.middle[0] + right * this.scale, this.middle[1] - up * this.scale];
  }

  toPlan([left, top]: Point): Point {
    const [right, up] = [(left - this.middle[0]) / this.scale, (this.middle[1] - top) / this.scale];
    const [x, y] = this.isTurned ? [-up, right] : [right, up];
    return [x + this.centre[0], y + this.centre[1]];
  }

  private size(axis: 0 | 1): number {
    return Math.max(high(this.plan, axis) - low(this.plan, axis), 0.1 * this.plan.unit);
  }
}

function low(plan: FloorPlanModel, axis: 0 | 1): number {
  return plan.low[axis] ?? 0;
}

function high(plan: FloorPlanModel, axis: 0 | 1): number {
  return plan.high[axis] ?? 0;
}
