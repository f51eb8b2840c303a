// What a person looks at again: a recorded navigation, or two that are compared.
import type * as THREE from "three";
import { SceneLayer } from "./layer";

export class ReviewLayer extends SceneLayer {
  readonly emptyText = "This navigation has no landmarks: SLAM did not finish.";

  open(content: THREE.Object3D, box: THREE.Box3 | null, points: number): void {
    this.clear();
    this.group.add(content);
    this.space = box;
    this.count = points;
  }

  /** Its content takes up another space. */
  resize(box: THREE.Box3 | null): void {
    this.space = box;
  }
}
