// Where a view of points must reach. Only numbers: it is tested by itself.
import * as THREE from "three";
import type { Cloud } from "./cloud";

/**
 * Box of the points. A few stray ones must not shrink the view: it reaches out from where 96 % of them are on each axis by
 * no more than a quarter of that, so that a room with few landmarks at the end of a corridor is in it.
 */
export function extent(cloud: Cloud): THREE.Box3 | null {
  const floats = cloud.buffer.array as Float32Array;
  const count = floats.length / 4;
  const box = new THREE.Box3();
  const step = Math.max(1, Math.floor(count / 4000));
  for (let axis = 0; axis < 3; axis++) {
    const values: number[] = [];
    for (let i = 0; i < count; i += step) {
      const value = floats[i * 4 + axis] ?? NaN;
      if (Number.isFinite(value)) values.push(value); // others are nowhere, and would be sorted anywhere
    }
    if (!values.length) return null;
    values.sort((a, b) => a - b);
    const at = (share: number) => values[Math.min(values.length - 1, Math.floor(values.length * share))] ?? 0;
    const [low, high] = [at(0.02), at(0.98)];
    const reach = (high - low) / 4;
    box.min.setComponent(axis, Math.max(at(0.001), low - reach));
    box.max.setComponent(axis, Math.min(at(0.999), high + reach));
  }
  return box;
}
