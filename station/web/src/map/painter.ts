// Draws the scene, and only when something changed.
import * as THREE from "three";
import { setPointSize, thinOut } from "./cloud";
import { isSoftware, Pace } from "./pace";

const DATA_REDRAW_MS = 250;
const DATA_SHARE = 4; // such a redraw may keep the machine busy for a quarter of the time at most

/** What there is to draw. */
export interface Subject {
  group: THREE.Group;
  points: number;
  camera: THREE.Camera;
  isTurning: boolean; // then it must follow the hand, and less is drawn
}

export class Painter {
  private readonly isSoftware = isSoftware();
  private readonly renderer = new THREE.WebGLRenderer({
    antialias: !this.isSoftware,
    alpha: true,
    powerPreference: "low-power",
  });
  private readonly pace = new Pace(this.renderer.getContext() as WebGL2RenderingContext, this.isSoftware);
  private readonly scene = new THREE.Scene();
  private readonly pixelRatio = Math.min(devicePixelRatio, 2);
  private pixels = 0; // per pixel of the page, as last drawn
  private isPending = false;
  /** Nothing is drawn: something else lies over it. */
  isResting = false;
  private soon = 0;

  /** `onDrawn` is told which share of the points was drawn. */
  constructor(
    private readonly subject: () => Subject,
    private readonly onDrawn: (share: number) => void,
  ) {
    this.renderer.outputColorSpace = THREE.LinearSRGBColorSpace; // colours go to the screen as they came
    this.canvas.setAttribute("aria-hidden", "true");
  }

  get canvas(): HTMLCanvasElement {
    return this.renderer.domElement;
  }

  add(...objects: THREE.Object3D[]): void {
    this.scene.add(...objects);
  }

  setSize(width: number, height: number): void {
    this.renderer.setSize(width, height, false);
  }

  draw(): void {
    if (this.isPending || this.isResting) return;
    this.isPending = true;
    this.pace.whenFree(() => requestAnimationFrame(() => this.render()));
  }

  /** For changes that no hand makes: a few pictures a second, so that video and joystick keep the machine. */
  drawSoon(): void {
    this.soon ||= window.setTimeout(
      () => {
        this.soon = 0;
        this.draw();
      },
      Math.max(DATA_REDRAW_MS, DATA_SHARE * this.pace.lastMs),
    );
  }

  private render(): void {
    this.isPending = false;
    if (this.isResting) return;
    const { group, points, camera, isTurning } = this.subject();
    const share = isTurning ? this.pace.share(points) : 1;
    const pixels = this.pixelRatio * (isTurning ? this.pace.pixels(points) : 1);
    if (pixels !== this.pixels) {
      this.pixels = pixels;
      this.renderer.setPixelRatio(pixels);
    }
    thinOut(group, share);
    setPointSize(pixels * pointSize(points * share));
    this.pace.begin(points * share);
    this.renderer.render(this.scene, camera);
    this.pace.end();
    this.onDrawn(share);
  }
}

/** Pixels of the page: fewer points are larger, so that walls look closed. */
function pointSize(points: number): number {
  return points > 60_000 ? 1.4 : points > 15_000 ? 2 : 3.2;
}
