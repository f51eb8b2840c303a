// Where the view of a cloud reaches (src/map/extent.ts), of points that are somewhere.
import assert from "node:assert/strict";
import { test } from "node:test";
import * as THREE from "three";
import { extent } from "../src/map/extent";

function cloudOf(points: [number, number, number][]) {
  const rows = points.flatMap((p) => [...p, 0]);
  return { buffer: new THREE.InterleavedBuffer(new Float32Array(rows), 4), first: 0, total: points.length, source: "" };
}

const GRID = Array.from({ length: 100 }, (_, i): [number, number, number] => [i % 10, Math.floor(i / 10), 1]);

void test("points that are nowhere do not shape the view", () => {
  const whole = extent(cloudOf(GRID));
  assert.ok(whole);
  const nowhere: [number, number, number][] = [
    [NaN, NaN, NaN],
    [Infinity, 1, 1],
    [1, -Infinity, 1],
  ];
  const mixed = GRID.flatMap((p, i) => (i % 20 ? [p] : [...nowhere, p]));
  const box = extent(cloudOf(mixed));
  assert.ok(box && box.min.distanceTo(whole.min) < 1 && box.max.distanceTo(whole.max) < 1, JSON.stringify(box));
  assert.equal(extent(cloudOf([[NaN, NaN, NaN]])), null);
});
