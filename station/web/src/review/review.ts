// What a person looks at again in the 3D view: a recorded navigation, or two before and after registration.
import * as THREE from "three";
import { call } from "../link/api";
import type { ComparisonModel, NavigationModel } from "../link/messages";
import { fetchCloud, toPoints } from "../map/cloud";
import { extent } from "../map/extent";
import { toMatrix } from "../map/transform";
import type { MapView } from "../map/view";
import { by, setText, show } from "../ui/dom";
import { Switch } from "../ui/switch";
import { Replay } from "./replay";

const FIRST = 0x2dd4bf;
const SECOND = 0xfb923c;

export class Review {
  private readonly replayed: Replay;
  private readonly registration = new Switch("registered", (value) => this.register(value === "true"));
  private second: THREE.Group | null = null;
  private T_first_second: number[] | null = null;
  private boxes: [THREE.Box3 | null, THREE.Box3 | null] = [null, null];
  private opened = 0;

  constructor(private readonly map: MapView | null) {
    this.replayed = new Replay(map);
    by("review-close").addEventListener("click", () => this.close());
  }

  async replay(navigation: NavigationModel): Promise<void> {
    this.opened += 1;
    this.show(navigation.name, "replay", navigation.state === "ready" ? "" : navigation.message);
    await this.replayed.open(navigation);
  }

  async compare(id: string): Promise<void> {
    const turn = ++this.opened;
    this.replayed.close();
    const comparison = await call<ComparisonModel>("GET", `/comparisons/${id}`);
    const [first, second] = await Promise.all([
      fetchCloud(`/navigations/${comparison.first}/landmarks`),
      fetchCloud(`/navigations/${comparison.second}/landmarks`),
    ]);
    if (turn !== this.opened) return;
    const said = comparison.accepted
      ? `${comparison.matches} of ${comparison.places} places found again. First navigation turquoise, second orange.`
      : `They could not be registered: ${comparison.reasons.join("; ")}.`;
    this.show(comparison.name, "compare", said);
    by("report", HTMLAnchorElement).href = comparison.report;
    const download = by("report-download", HTMLAnchorElement);
    download.href = comparison.report;
    download.download = `${comparison.id}.html`;
    this.T_first_second = comparison.T_first_second;
    this.second = new THREE.Group();
    this.second.matrixAutoUpdate = false;
    this.second.add(toPoints(second, SECOND));
    const content = new THREE.Group();
    content.add(toPoints(first, FIRST), this.second);
    this.boxes = [extent(first), extent(second)];
    this.map?.openReview(content, this.box(comparison.accepted), first.total + second.total);
    for (const button of document.querySelectorAll<HTMLButtonElement>("[data-registered=true]"))
      button.disabled = !comparison.accepted || !comparison.T_first_second;
    this.register(comparison.accepted);
  }

  /** What holds both clouds. */
  private box(registered: boolean): THREE.Box3 | null {
    const [first, second] = this.boxes;
    if (!second) return first;
    const moved = second.clone();
    if (registered && this.T_first_second) moved.applyMatrix4(toMatrix(this.T_first_second));
    return first ? moved.union(first) : moved;
  }

  private register(on: boolean): void {
    if (!this.second) return;
    this.second.matrix.copy(on && this.T_first_second ? toMatrix(this.T_first_second) : new THREE.Matrix4());
    this.second.matrixWorldNeedsUpdate = true;
    this.registration.show(String(on));
    this.map?.reframeReview(this.box(on));
  }

  private close(): void {
    this.opened += 1;
    this.replayed.close();
    this.second = null;
    show(by("review"), false);
    this.map?.closeReview();
  }

  private show(title: string, kind: "replay" | "compare", note: string): void {
    setText(by("review-title"), title);
    setText(by("review-note"), note);
    setText(by("review-layer"), kind === "replay" ? "Replay" : "Compare");
    show(by("review"), true);
    show(by("review-replay"), kind === "replay");
    show(by("review-compare"), kind === "compare");
    by("review").scrollIntoView({ block: "nearest" });
  }
}
