// What the 3D view can show, one at a time: each layer owns its objects and knows how much space they take up.
import * as THREE from "three";
import { type Cloud, dispose, toPoints } from "./cloud";
import { extent } from "./extent";

export interface LayerEvents {
  /** Its objects take up more space. */
  onGrown: (layer: SceneLayer) => void;
  /** It has other points. */
  onPoints: () => void;
}

export abstract class SceneLayer {
  readonly group = new THREE.Group();
  protected space: THREE.Box3 | null = null;
  protected count = 0;

  /** What to say where nothing is to be seen. */
  abstract readonly emptyText: string;
  /** The robot in it; null: there is none to follow. */
  readonly robot: THREE.Group | null = null;

  constructor(protected readonly events: LayerEvents) {}

  /** What holds everything in it; null: nothing is in it. */
  get box(): THREE.Box3 | null {
    return this.space;
  }

  get points(): number {
    return this.count;
  }

  get isEmpty(): boolean {
    return !this.count;
  }

  /** How much is in it, in words. */
  get summary(): string {
    return this.count ? `${this.count.toLocaleString()} landmarks` : "";
  }

  protected addCloud(cloud: Cloud): void {
    if (cloud.buffer.count) this.group.add(toPoints(cloud));
    this.count = cloud.total;
    this.grow(extent(cloud));
    this.events.onPoints();
  }

  protected grow(box: THREE.Box3 | null): void {
    if (box) this.space = this.space?.union(box) ?? box;
    this.events.onGrown(this);
  }

  /** Give everything back; the robot stays. */
  clear(): void {
    for (const child of [...this.group.children]) {
      if (child === this.robot) continue;
      this.group.remove(child);
      dispose(child);
    }
    this.space = null;
    this.count = 0;
  }
}
