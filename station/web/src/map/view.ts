// The 3D view: the active map, the running navigation, or what a person looks at again.
import type * as THREE from "three";
import type { CurrentPlace, PlaceModel, SlamModel } from "../link/messages";
import { by, setText, show } from "../ui/dom";
import { Switch } from "../ui/switch";
import { Ground } from "./ground";
import type { SceneLayer } from "./layer";
import type { PlanView } from "../plan/view";
import { LiveLayer } from "./live_layer";
import { MapLayer } from "./map_layer";
import { Painter, type Subject } from "./painter";
import { ReviewLayer } from "./review_layer";
import { type View, Viewpoint } from "./viewpoint";

type LayerName = "plan" | "map" | "live" | "review"; // the plan lies over the 3D view, which rests meanwhile

export interface MapViewEvents {
  /** The name of a place was clicked. */
  onPlace: (place: PlaceModel) => void;
  /** There are places of another map, or changed ones; hidden ones too. */
  onPlaces: (places: PlaceModel[]) => void;
}

/** Which layer is shown, and whether a person chose it. */
interface Choice {
  name: LayerName;
  isChosen: boolean;
}

export class MapView {
  private readonly host = by("scene");
  private readonly painter = new Painter(
    () => this.subject(),
    (share) => this.finish(share),
  );
  private readonly viewpoint: Viewpoint;
  private readonly ground = new Ground();
  private readonly map: MapLayer;
  private readonly live: LiveLayer;
  private readonly review: ReviewLayer;
  private readonly layerSwitch = new Switch("layer", (name) => this.chooseLayer(name as LayerName));
  private readonly viewSwitch = new Switch("view", (view) => this.chooseView(view as View));
  private choice: Choice = { name: "map", isChosen: false };
  private before = this.choice; // what a review that is closed gives way to
  private numDrawn = 0;

  constructor(
    video: HTMLCanvasElement,
    private readonly plan: PlanView,
    events: MapViewEvents,
  ) {
    this.host.prepend(this.painter.canvas);
    const layerEvents = { onGrown: (layer: SceneLayer) => this.fit(layer), onPoints: () => this.describePoints() };
    this.map = new MapLayer(video, { ...layerEvents, ...events, onMap: (isOther) => this.takeMap(isOther) });
    this.live = new LiveLayer(video, { ...layerEvents, onAnew: () => this.frameAll() });
    this.review = new ReviewLayer(layerEvents);
    this.viewpoint = new Viewpoint(this.painter.canvas, {
      onTurn: () => this.painter.draw(),
      onMove: () => this.painter.drawSoon(),
      onView: (view) => this.viewSwitch.show(view),
    });
    this.painter.add(this.ground.grid, this.map.group, this.live.group, this.review.group);
    new ResizeObserver(() => this.resize()).observe(this.host);
    this.showLayer("map");
    this.chooseView("top");
  }

  /** Show another active map, or its new names. The newest call wins. */
  showMap(id: string | null, revision: number): Promise<void> {
    return this.map.showMap(id, revision);
  }

  showPlace(place: CurrentPlace): void {
    this.map.showPlace(place);
    this.followIn(this.map);
  }

  showSlam(slam: SlamModel): void {
    this.live.showSlam(slam);
    this.followIn(this.live);
  }

  /** There are new landmarks, or another navigation runs. */
  updateLive(source: string | null, total: number): Promise<void> {
    return this.live.update(source, total);
  }

  /** Landmarks of a navigation are there: shown where there is no map to look at, and nobody chose what to see. */
  suggestLive(): void {
    if (!this.choice.isChosen && !this.map.hasMap) this.showLayer("live");
  }

  /** Show something beside map and navigation until closeReview: a recorded navigation, or two that are compared. */
  openReview(content: THREE.Object3D, box: THREE.Box3 | null, points: number): void {
    if (this.choice.name !== "review") this.before = this.choice;
    this.review.open(content, box, points);
    show(by("review-layer"), true);
    this.showLayer("review", true);
    this.frameAll();
  }

  closeReview(): void {
    this.review.clear();
    show(by("review-layer"), false);
    if (this.choice.name === "review") this.showLayer(this.before.name, this.before.isChosen);
    else this.choice = { ...this.choice, isChosen: this.before.isChosen };
  }

  /** What openReview was given takes up another space. */
  reframeReview(box: THREE.Box3 | null): void {
    this.review.resize(box);
    if (this.layer === this.review) this.frameAll();
  }

  /** What openReview was given has changed. */
  redraw(): void {
    this.painter.drawSoon();
  }

  private get layer(): SceneLayer {
    return this.isPlan ? this.map : this[this.choice.name as "map" | "live" | "review"];
  }

  private get isPlan(): boolean {
    return this.choice.name === "plan";
  }

  private chooseLayer(name: LayerName): void {
    this.before = { ...this.before, isChosen: true };
    this.showLayer(name, true);
  }

  private showLayer(name: LayerName, isChosen = this.choice.isChosen): void {
    const isOther = name !== this.choice.name;
    this.choice = { name, isChosen };
    for (const layer of [this.map, this.live, this.review]) layer.group.visible = layer === this.layer;
    this.layerSwitch.show(name);
    this.plan.setVisible(this.isPlan);
    this.painter.isResting = this.isPlan;
    for (const id of ["views", "labels"]) show(by(id), !this.isPlan);
    if (isOther) this.frameAll();
    this.describe();
    this.painter.draw();
  }

  private chooseView(view: View): void {
    this.viewpoint.choose(view);
    this.frameAll();
  }

  private takeMap(isOther: boolean): void {
    show(by("plan-layer"), this.plan.hasPlan);
    if (this.isPlan && !this.plan.hasPlan) this.showLayer("map");
    if (isOther) {
      if (!this.choice.isChosen) this.showLayer(this.plan.hasPlan ? "plan" : this.map.hasMap ? "map" : "live");
      this.frameAll();
    }
    this.describe();
    this.painter.draw();
  }

  private describePoints(): void {
    this.describe();
    this.painter.drawSoon();
  }

  private frameAll(): void {
    this.ground.placeUnder(this.viewpoint.frame(this.layer.box, this.layer.robot));
    this.painter.draw();
  }

  /** A layer has grown: show all of it, unless it is another one, or a hand chose the view. */
  private fit(layer: SceneLayer): void {
    if (layer === this.layer && this.viewpoint.isOutgrownBy(layer.box)) this.frameAll();
  }

  private followIn(layer: SceneLayer): void {
    if (layer === this.layer) this.viewpoint.follow(layer.robot);
    this.painter.drawSoon();
  }

  private describe(): void {
    setText(by("map-count"), this.isPlan ? "" : this.layer.summary);
    const empty = by("scene-empty");
    show(empty, this.layer.isEmpty && !this.isPlan);
    setText(empty, this.layer.emptyText);
  }

  private resize(): void {
    const { clientWidth: width, clientHeight: height } = this.host;
    if (!width || !height) return;
    this.painter.setSize(width, height);
    this.viewpoint.setAspect(width / height);
    this.frameAll();
  }

  private subject(): Subject {
    const { camera, isTurning } = this.viewpoint;
    return { group: this.layer.group, points: this.layer.points, camera, isTurning };
  }

  /** The names of places lie over the picture; the rest is for tests and measurements. */
  private finish(share: number): void {
    this.map.placeLabels(this.viewpoint.camera, this.layer === this.map, this.host);
    this.numDrawn += 1;
    const { box } = this.layer;
    this.host.dataset.frames = String(this.numDrawn);
    this.host.dataset.share = share.toFixed(3);
    this.host.dataset.whole = String(!box || this.viewpoint.sees(box));
  }
}
