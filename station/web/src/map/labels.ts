// Names of places and bearings over the 3D view; where they would cover each other, the more important one is read.
import * as THREE from "three";

const DOT_PX = 14;
const GAP_PX = 2;

interface Label {
  node: HTMLElement;
  at: THREE.Vector3;
  weight: number; // of places more than of bearings
  size: [number, number] | null; // px, of the whole text; measured when it is first drawn
}

export class Labels {
  private labels: Label[] = [];
  private write: (() => void) | null = null;
  private here: string | null = null;

  constructor(private readonly host: HTMLElement) {}

  /** Others instead: `write` adds them once they are to be seen, which under the floor plan they are not. */
  replace(write: () => void): void {
    this.labels = [];
    this.host.replaceChildren();
    this.write = write;
  }

  /** A label at a point of the scene; the heavier ones are read first. */
  add(node: HTMLElement, at: THREE.Vector3, weight: number): void {
    this.labels.push({ node, at, weight, size: null });
  }

  /** The place where the robot is comes before all others. */
  setHere(placeId: string | null): void {
    this.here = placeId;
    this.markHere();
  }

  private markHere(): void {
    const placeId = this.here;
    for (const label of this.labels) {
      const here = placeId !== null && label.node.dataset.place === placeId;
      if (here !== isHere(label)) label.size = null; // it is written larger
      label.node.classList.toggle("here", here);
    }
  }

  /** Put all of them where the camera sees their points. A place whose name has no room stays as a dot; a bearing goes. */
  place(camera: THREE.Camera, visible: boolean, scene: HTMLElement): void {
    this.host.hidden = !visible;
    const { clientWidth: width, clientHeight: height } = scene;
    if (!visible || !width) return;
    this.begin();
    this.measure();
    const taken: [number, number, number, number][] = [];
    const isFree = (x: number, y: number, w: number, h: number) =>
      taken.every(([l, t, r, b]) => x + w / 2 < l || x - w / 2 > r || y + h / 2 < t || y - h / 2 > b);
    const take = (x: number, y: number, w: number, h: number) =>
      taken.push([x - w / 2 - GAP_PX, y - h / 2 - GAP_PX, x + w / 2 + GAP_PX, y + h / 2 + GAP_PX]);
    const p = new THREE.Vector3();
    const seen = this.labels.flatMap((label) => {
      p.copy(label.at).project(camera);
      const inside = p.z < 1 && Math.abs(p.x) < 1.02 && Math.abs(p.y) < 1.02;
      label.node.style.display = inside ? "" : "none";
      const { size } = label;
      return inside && size ? [{ label, size, x: ((p.x + 1) / 2) * width, y: ((1 - p.y) / 2) * height }] : [];
    });
    for (const one of seen.sort((a, b) => Number(isHere(b.label)) - Number(isHere(a.label)))) {
      const { node } = one.label;
      const isPlace = node.dataset.place !== undefined;
      const [w, h] = one.size;
      // A name at the edge moves in as a whole, and makes way for a heavier one; a bearing stays where its line is.
      const x = isPlace ? Math.min(Math.max(one.x, w / 2 + GAP_PX), width - w / 2 - GAP_PX) : one.x;
      const step = h + 2 * GAP_PX;
      const inside = (y: number) => Math.min(Math.max(y, h / 2 + GAP_PX), height - h / 2 - GAP_PX);
      const here = isPlace ? inside(one.y) : one.y;
      const beside = isPlace ? [-step, step, -2 * step, 2 * step].map((dy) => inside(one.y + dy)) : [];
      const free = [here, ...beside].find((y) => isFree(x, y, w, h));
      // Where the robot is, and what a person named, is always read, however narrow it gets.
      const fits = free !== undefined || isHere(one.label) || node.dataset.named === "true";
      const y = free ?? (fits ? here : one.y);
      if (isPlace) node.classList.toggle("dot", !fits);
      else if (!fits) node.style.display = "none";
      if (fits) take(x, y, w, h);
      else if (isPlace) take(one.x, one.y, DOT_PX, DOT_PX);
      node.style.transform = `translate(-50%,-50%) translate(${fits ? x : one.x}px,${y}px)`;
    }
  }

  private begin(): void {
    if (!this.write) return;
    this.write();
    this.write = null;
    this.host.append(...this.labels.map(({ node }) => node));
    this.labels.sort((a, b) => b.weight - a.weight);
    this.markHere();
  }

  /** All unmeasured ones at once, so that the browser lays the page out once. */
  private measure(): void {
    const unknown = this.labels.filter((label) => !label.size);
    for (const { node } of unknown) {
      node.classList.remove("dot");
      node.style.display = "";
    }
    for (const label of unknown) label.size = [label.node.offsetWidth, label.node.offsetHeight];
  }
}

function isHere(label: Label): boolean {
  return label.node.classList.contains("here");
}
