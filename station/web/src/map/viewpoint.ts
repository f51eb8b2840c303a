// Where the scene is seen from: what a hand makes of it, and how all of it comes into the picture.
import * as THREE from "three";
import { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";

export const VIEWS = ["follow", "top", "free"] as const;
export type View = (typeof VIEWS)[number];

const LET_GO_MS = 100;
const REST_MS = 200; // a hand that holds the view still for so long wants to see everything
const EMPTY = new THREE.Box3(new THREE.Vector3(-3, -3, 0), new THREE.Vector3(3, 3, 1)); // framed where there is nothing
const FROM_ABOVE = new THREE.Vector3(0, -0.001, 1);
const ASLANT = new THREE.Vector3(-0.45, -0.75, 0.62).normalize();

export interface ViewpointEvents {
  /** A hand turns or moves the view, or lets it rest. */
  onTurn: () => void;
  /** It moved by itself. */
  onMove: () => void;
  onView: (view: View) => void;
}

export class Viewpoint {
  readonly camera = new THREE.PerspectiveCamera(50, 1, 0.02, 500);
  private readonly controls: OrbitControls;
  private view: View = "top";
  private turning = false; // a hand turns or moves the view
  private isHeld = false;
  private isMoved = false; // a hand did so since all was in the picture: then it is not moved away from what the hand chose
  private framed: THREE.Box3 | null = null; // what was in the picture then
  private resting = 0;

  constructor(
    canvas: HTMLElement,
    private readonly events: ViewpointEvents,
  ) {
    this.camera.up.set(0, 0, 1);
    this.controls = new OrbitControls(this.camera, canvas);
    this.controls.enableDamping = false;
    this.controls.addEventListener("start", () => {
      this.isHeld = this.isMoved = true;
      if (this.view === "follow") this.choose("free");
    });
    this.controls.addEventListener("change", () => this.turn());
    this.controls.addEventListener("end", () => {
      this.isHeld = false;
      this.restAfter(LET_GO_MS); // the next turn of a mouse wheel comes sooner
    });
  }

  get isTurning(): boolean {
    return this.turning;
  }

  choose(view: View): void {
    this.view = view;
    this.controls.enableRotate = view !== "top";
    this.events.onView(view);
  }

  setAspect(aspect: number): void {
    this.camera.aspect = aspect;
    this.camera.updateProjectionMatrix();
  }

  /** Show all of a box, or some empty space where there is none; returns what is shown. */
  frame(box: THREE.Box3 | null, robot: THREE.Group | null): THREE.Box3 {
    this.isMoved = false;
    this.framed = box?.clone() ?? null;
    const shown = box ?? EMPTY;
    const centre = shown.getCenter(new THREE.Vector3());
    const size = shown.getSize(new THREE.Vector3());
    const tangent = Math.tan((this.camera.fov * Math.PI) / 360);
    const wide = Math.max(size.y, size.x / this.camera.aspect, 1.5);
    const distance = (0.56 * wide) / tangent + size.z / 2;
    this.controls.target.copy(centre);
    this.camera.position.copy(centre).addScaledVector(this.view === "top" ? FROM_ABOVE : ASLANT, distance);
    this.camera.near = distance / 200;
    this.camera.far = distance * 20;
    this.camera.updateProjectionMatrix();
    this.follow(robot);
    this.controls.update();
    return shown;
  }

  /** Whether what was framed has grown out of the picture; not where a hand chose the view, or it follows the robot. */
  isOutgrownBy(box: THREE.Box3 | null): boolean {
    if (this.isMoved || this.view === "follow" || !box) return false;
    return !this.framed?.containsBox(box);
  }

  /** Stay with the robot, where that is wanted and somebody knows where it is. */
  follow(robot: THREE.Group | null): void {
    if (this.view !== "follow" || !robot?.visible) return;
    const move = robot.position.clone().sub(this.controls.target);
    this.controls.target.add(move);
    this.camera.position.add(move);
    this.controls.update();
  }

  /** Whether all of a box lies in the picture. */
  sees({ min, max }: THREE.Box3): boolean {
    const corners = [0, 1, 2, 3, 4, 5, 6, 7].map(
      (i) => new THREE.Vector3(i & 1 ? max.x : min.x, i & 2 ? max.y : min.y, i & 4 ? max.z : min.z),
    );
    return corners.every((p) => Math.max(Math.abs(p.project(this.camera).x), Math.abs(p.y)) <= 1);
  }

  private turn(): void {
    if (!this.isHeld) {
      this.events.onMove();
      return;
    }
    this.turning = true;
    this.restAfter(REST_MS);
    this.events.onTurn();
  }

  private restAfter(ms: number): void {
    clearTimeout(this.resting);
    this.resting = window.setTimeout(() => {
      const wasTurning = this.turning;
      this.turning = false;
      if (wasTurning) this.events.onTurn();
    }, ms);
  }
}
