// A grid of metres under what is shown.
import * as THREE from "three";

const COLOUR = 0x808890;

export class Ground {
  readonly grid = new THREE.GridHelper(40, 40, COLOUR, COLOUR);

  constructor() {
    this.grid.rotation.x = Math.PI / 2;
    this.grid.material.transparent = true;
    this.grid.material.opacity = 0.13;
  }

  placeUnder(box: THREE.Box3): void {
    const centre = box.getCenter(new THREE.Vector3());
    this.grid.position.set(Math.round(centre.x), Math.round(centre.y), box.min.z);
  }
}
