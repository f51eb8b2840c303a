// The camera in the 3D view: a frustum with the picture in it.
import * as THREE from "three";
import { toMatrix } from "./transform";

export class Camera3d {
  readonly group = new THREE.Group();
  private readonly texture: THREE.CanvasTexture;

  constructor(video: HTMLCanvasElement) {
    const [w, h, d] = [0.24, 0.18, 0.34];
    const tip = new THREE.Vector3();
    const topLeft = new THREE.Vector3(-w, -h, d); // the camera's y points down
    const topRight = new THREE.Vector3(w, -h, d);
    const bottomRight = new THREE.Vector3(w, h, d);
    const bottomLeft = new THREE.Vector3(-w, h, d);
    const sides = [
      [topLeft, topRight],
      [topRight, bottomRight],
      [bottomRight, bottomLeft],
      [bottomLeft, topLeft],
    ] as const;
    const line = sides.flatMap(([from, to]) => [tip, from, from, to]);
    const edges = new THREE.LineSegments(
      new THREE.BufferGeometry().setFromPoints(line),
      new THREE.LineBasicMaterial({ color: 0xff5a36 }),
    );
    this.texture = new THREE.CanvasTexture(video);
    this.texture.generateMipmaps = false; // they cost more than the picture, and it is small
    this.texture.minFilter = THREE.LinearFilter;
    const picture = new THREE.Mesh(
      new THREE.PlaneGeometry(2 * w, 2 * h),
      new THREE.MeshBasicMaterial({ map: this.texture, side: THREE.DoubleSide }),
    );
    picture.position.z = d;
    picture.rotation.x = Math.PI; // so its picture is upside down
    const body = new THREE.Mesh(
      new THREE.SphereGeometry(0.06, 16, 12),
      new THREE.MeshBasicMaterial({ color: 0xff5a36 }),
    );
    this.group.add(edges, picture, body);
    this.group.visible = false;
  }

  /** Put it where T_world_cam (row-major 4x4) says; null: nobody knows. */
  place(T: number[] | null): void {
    this.group.visible = T !== null;
    if (!T) return;
    toMatrix(T).decompose(this.group.position, this.group.quaternion, new THREE.Vector3());
    this.texture.needsUpdate = true;
  }
}
