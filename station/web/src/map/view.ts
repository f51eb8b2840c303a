// The 3D view: cloud, trajectory, camera, places with names, graph. Drawn only when something changed.
import * as THREE from "three";
import { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";
import { call } from "../link/api";
import type {
  CurrentPlace,
  GraphModel,
  PlaceModel,
  PlacesChangeModel,
  SlamModel,
  TrajectoryModel,
} from "../link/messages";
import { Refresh } from "../link/refresh";
import { by, setText, show } from "../ui/dom";
import { Camera3d } from "./camera";
import { type Cloud, dispose, extent, fetchCloud, setPointSize, thinOut, toPoints } from "./cloud";
import { Graph3d } from "./graph";
import { Labels } from "./labels";
import { isSoftware, Pace } from "./pace";

type View = "follow" | "top" | "free";
type Layer = "map" | "live" | "review"; // of the active map, of the running or last navigation, of what a person looks at again
const DATA_REDRAW_MS = 250;
const DATA_SHARE = 4; // such a redraw may keep the machine busy for a quarter of the time at most
const LET_GO_MS = 100;
const REST_MS = 200; // a hand that holds the view still for so long wants to see everything
const MAX_CHUNKS = 40; // then the live cloud is fetched whole again: fewer, larger buffers draw faster

export class MapView {
  onPlace: (place: PlaceModel) => void = () => {};
  onPlaces: (places: PlaceModel[], changes: PlacesChangeModel[]) => void = () => {}; // of another map, or changed ones; hidden ones too
  private graph: GraphModel | null = null;
  private readonly host = by("scene");
  private readonly labels = new Labels(by("labels"));
  private readonly net = new Graph3d(this.labels);
  private readonly software = isSoftware();
  private readonly renderer = new THREE.WebGLRenderer({
    antialias: !this.software,
    alpha: true,
    powerPreference: "low-power",
  });
  private readonly pixelRatio = Math.min(devicePixelRatio, 2);
  private pixels = 0; // per pixel of the page, as last drawn
  private readonly camera = new THREE.PerspectiveCamera(50, 1, 0.02, 500);
  private readonly controls: OrbitControls;
  private readonly groups: Record<Layer, THREE.Group> = {
    map: new THREE.Group(),
    live: new THREE.Group(),
    review: new THREE.Group(),
  };
  private readonly scene = new THREE.Scene();
  private readonly robot: Record<"map" | "live", Camera3d>;
  private readonly grid: THREE.GridHelper;
  private readonly track: THREE.Vector3[] = [];
  private trackLine: THREE.Line | null = null;
  private boxes: Record<Layer, THREE.Box3 | null> = { map: null, live: null, review: null };
  private points: Record<Layer, number> = { map: 0, live: 0, review: 0 };
  private layer: Layer = "map";
  private layerBefore: Layer = "map";
  private view: View = "top";
  private chosenLayer = false;
  private chosenBefore = false;
  private pending = false;
  private soon = 0;
  private isTurning = false; // a hand turns or moves the view
  private isMoved = false; // one did so since all was in the picture: then it is not moved away from what the hand chose
  private framed: THREE.Box3 | null = null; // what was in the picture then
  private resting = 0;
  private readonly pace = new Pace(this.renderer.getContext() as WebGL2RenderingContext, this.software);
  private map: { id: string | null; revision: number } = { id: null, revision: -1 };
  private wantedMap: { id: string | null; revision: number } = { id: null, revision: -1 };
  private readonly mapContent = new Refresh(() => this.fetchMap());
  private live = { navigation: "", total: 0, chunks: 0 };
  private wantedLive = { navigation: "", total: 0 };
  private readonly liveContent = new Refresh(() => this.fetchLive());
  private currentPlaceId: string | null = null;
  frames = 0; // drawn so far, for tests and measurements

  constructor(video: HTMLCanvasElement) {
    THREE.Object3D.DEFAULT_UP.set(0, 0, 1);
    this.camera.up.set(0, 0, 1);
    this.renderer.outputColorSpace = THREE.LinearSRGBColorSpace; // colours go to the screen as they came
    this.host.prepend(this.renderer.domElement);
    this.renderer.domElement.setAttribute("aria-hidden", "true");
    this.controls = new OrbitControls(this.camera, this.renderer.domElement);
    this.controls.enableDamping = false;
    let isHeld = false;
    const rest = () => {
      if (this.isTurning) this.draw();
      this.isTurning = false;
    };
    this.controls.addEventListener("change", () => {
      if (!isHeld) return this.drawSoon();
      this.isTurning = true;
      clearTimeout(this.resting);
      this.resting = window.setTimeout(rest, REST_MS);
      this.draw();
    });
    this.controls.addEventListener("end", () => {
      isHeld = false;
      clearTimeout(this.resting);
      this.resting = window.setTimeout(rest, LET_GO_MS); // the next turn of a mouse wheel comes sooner
    });
    this.controls.addEventListener("start", () => {
      isHeld = this.isMoved = true;
      if (this.view === "follow") this.setView("free", false);
    });
    this.grid = new THREE.GridHelper(40, 40, 0x808890, 0x808890);
    this.grid.rotation.x = Math.PI / 2;
    const lines = this.grid.material as THREE.Material;
    lines.transparent = true;
    lines.opacity = 0.13;
    this.robot = { map: new Camera3d(video), live: new Camera3d(video) };
    this.groups.map.add(this.robot.map.group);
    this.groups.live.add(this.robot.live.group);
    this.scene.add(this.grid, ...Object.values(this.groups));
    new ResizeObserver(() => this.resize()).observe(this.host);
    for (const button of document.querySelectorAll<HTMLElement>("[data-view]"))
      button.addEventListener("click", () => this.setView(button.dataset["view"] as View, true));
    for (const button of document.querySelectorAll<HTMLElement>("[data-layer]"))
      button.addEventListener("click", () => {
        this.chosenLayer = this.chosenBefore = true;
        this.setLayer(button.dataset["layer"] as Layer);
      });
    this.setLayer("map");
    this.setView("top", true);
  }

  /** Show another active map, or its new names. The newest call wins. */
  showMap(mapId: string | null, revision: number): Promise<void> {
    this.wantedMap = { id: mapId, revision };
    return this.mapContent.ask();
  }

  private async fetchMap(): Promise<void> {
    const wanted = this.wantedMap;
    if (wanted.id === null) {
      this.takeMap(wanted, null, [], [], null);
      return;
    }
    const isNew = wanted.id !== this.map.id || wanted.revision !== this.map.revision;
    try {
      const [graph, places, changes, cloud] = await Promise.all([
        call<GraphModel>("GET", "/graph"),
        call<PlaceModel[]>("GET", "/places"),
        call<PlacesChangeModel[]>("GET", "/places/changes"),
        isNew ? fetchCloud(`/maps/${wanted.id}/landmarks`) : null,
      ]);
      // Another one's graph: it was chosen meanwhile, and its event is on the way.
      if (this.wantedMap === wanted && graph.map === wanted.id) this.takeMap(wanted, graph, places, changes, cloud);
    } catch (error) {
      if (this.wantedMap === wanted) throw error; // of a map that nobody wants any more it means nothing
    }
  }

  private takeMap(
    map: { id: string | null; revision: number },
    graph: GraphModel | null,
    places: PlaceModel[],
    changes: PlacesChangeModel[],
    cloud: Cloud | null,
  ): void {
    const isOther = map.id !== this.map.id;
    this.map = map;
    this.graph = graph;
    this.onPlaces(places, changes);
    if (isOther || cloud) {
      this.clear("map");
      if (cloud) this.addCloud("map", cloud);
    }
    for (const node of graph?.nodes ?? [])
      // the middle of a place may lie beside its cloud
      this.boxes.map?.expandByPoint(new THREE.Vector3(...(node.centroid_map as [number, number, number])));
    if (isOther) {
      if (!this.chosenLayer) this.setLayer(map.id === null ? "live" : "map");
      this.frameAll();
    }
    this.net.show(graph, this.groups.map, (place) => this.onPlace(place));
    this.labels.setHere(this.currentPlaceId);
    this.describe();
    this.draw();
  }

  showPlace(place: CurrentPlace): void {
    this.robot.map.place(place.map === this.wantedMap.id ? place.pose_map : null); // in another active map it is elsewhere
    const id = place.place?.id ?? null;
    if (id !== this.currentPlaceId) {
      this.currentPlaceId = id;
      this.labels.setHere(id);
    }
    if (this.layer === "map") this.follow(this.robot.map.group);
    this.drawSoon();
  }

  showSlam(slam: SlamModel): void {
    this.robot.live.place(slam.T_world_cam);
    const T = slam.T_world_body;
    if (T && slam.navigation === this.live.navigation && slam.state !== "finished") {
      const p = new THREE.Vector3(T[3], T[7], T[11]);
      if (!this.track.length || this.track.at(-1)!.distanceTo(p) > 0.02) {
        this.track.push(p);
        this.showTrack();
      }
    }
    if (this.layer === "live") this.follow(this.robot.live.group);
    this.drawSoon();
  }

  /** There are new landmarks, or another navigation runs. */
  updateLive(source: string | null, total: number): Promise<void> {
    this.wantedLive = { navigation: source ?? "", total };
    return this.liveContent.ask();
  }

  private async fetchLive(): Promise<void> {
    const live = this.live;
    const wanted = this.wantedLive;
    const isNew = wanted.navigation !== live.navigation || wanted.total < live.total || live.chunks > MAX_CHUNKS;
    if (!isNew && wanted.total === live.total) return;
    const since = isNew ? 0 : live.total;
    const cloud = await fetchCloud(`/landmarks?since=${since}&navigation=${encodeURIComponent(live.navigation)}`);
    if (!cloud) return;
    if (isNew || cloud.first === 0) {
      const trajectory = await call<TrajectoryModel>("GET", "/trajectory?limit=4000");
      if ((trajectory.source ?? "") !== cloud.source) return; // another navigation began, or this one is finished: its event is on the way
      this.clear("live");
      live.chunks = 0;
      this.track.push(...trajectory.p_world.map((p) => new THREE.Vector3(p[0], p[1], p[2])));
      this.showTrack();
    }
    live.navigation = cloud.source;
    live.total = cloud.total;
    live.chunks += 1;
    this.addCloud("live", cloud);
    if (isNew) this.frameAll();
  }

  /** Landmarks of a navigation are there: shown where there is no map to look at, and nobody chose what to see. */
  suggestLive(): void {
    if (!this.chosenLayer && this.wantedMap.id === null) this.setLayer("live");
  }

  /** Show something beside map and navigation until closeReview: a recorded navigation, or two that are compared. */
  openReview(content: THREE.Object3D, box: THREE.Box3 | null, points: number): void {
    if (this.layer !== "review") [this.layerBefore, this.chosenBefore] = [this.layer, this.chosenLayer];
    this.clear("review");
    this.groups.review.add(content);
    this.boxes.review = box;
    this.points.review = points;
    this.chosenLayer = true;
    show(by("review-layer"), true);
    this.setLayer("review");
    this.frameAll();
  }

  closeReview(): void {
    this.clear("review");
    show(by("review-layer"), false);
    this.chosenLayer = this.chosenBefore;
    if (this.layer === "review") this.setLayer(this.layerBefore);
  }

  /** What openReview was given takes up another space. */
  reframeReview(box: THREE.Box3 | null): void {
    this.boxes.review = box;
    if (this.layer === "review") this.frameAll();
  }

  /** What openReview was given has changed. */
  redraw(): void {
    this.drawSoon();
  }

  private setLayer(layer: Layer): void {
    const changed = layer !== this.layer;
    this.layer = layer;
    for (const [name, group] of Object.entries(this.groups)) group.visible = name === layer;
    for (const button of document.querySelectorAll<HTMLElement>("[data-layer]"))
      button.setAttribute("aria-pressed", String(button.dataset["layer"] === layer));
    if (changed) this.frameAll();
    this.describe();
    this.draw();
  }

  private setView(view: View, frame: boolean): void {
    this.view = view;
    for (const button of document.querySelectorAll<HTMLElement>("[data-view]"))
      button.setAttribute("aria-pressed", String(button.dataset["view"] === view));
    this.controls.enableRotate = view !== "top";
    if (frame) this.frameAll();
  }

  private frameAll(): void {
    const box = this.boxes[this.layer] ?? new THREE.Box3(new THREE.Vector3(-3, -3, 0), new THREE.Vector3(3, 3, 1));
    this.isMoved = false;
    this.framed = this.boxes[this.layer]?.clone() ?? null;
    const centre = box.getCenter(new THREE.Vector3());
    const size = box.getSize(new THREE.Vector3());
    const tangent = Math.tan((this.camera.fov * Math.PI) / 360);
    const wide = Math.max(size.y, size.x / this.camera.aspect, 1.5);
    const distance = (0.56 * wide) / tangent + size.z / 2;
    this.controls.target.copy(centre);
    const offset =
      this.view === "top" ? new THREE.Vector3(0, -0.001, 1) : new THREE.Vector3(-0.45, -0.75, 0.62).normalize();
    this.camera.position.copy(centre).addScaledVector(offset, distance);
    this.camera.near = distance / 200;
    this.camera.far = distance * 20;
    this.camera.updateProjectionMatrix();
    this.grid.position.set(Math.round(centre.x), Math.round(centre.y), box.min.z);
    if (this.view === "follow" && this.layer !== "review") this.follow(this.robot[this.layer].group);
    this.controls.update();
    this.draw();
  }

  /** What is shown has grown: show all of it, unless a hand chose the view, or it follows the robot. */
  private fit(layer: Layer): void {
    const box = this.boxes[layer];
    if (layer !== this.layer || this.isMoved || this.view === "follow" || !box) return;
    if (!this.framed?.containsBox(box)) this.frameAll();
  }

  private follow(robot: THREE.Group): void {
    if (this.view !== "follow" || !robot.visible) return;
    const move = robot.position.clone().sub(this.controls.target);
    this.controls.target.add(move);
    this.camera.position.add(move);
    this.controls.update();
  }

  private addCloud(layer: Layer, cloud: Cloud): void {
    if (cloud.buffer.count) this.groups[layer].add(toPoints(cloud));
    this.points[layer] = cloud.total;
    const box = extent(cloud);
    if (box) this.boxes[layer] = this.boxes[layer]?.union(box) ?? box;
    this.fit(layer);
    this.describe();
    this.drawSoon();
  }

  private clear(layer: Layer): void {
    for (const child of [...this.groups[layer].children]) {
      if (layer !== "review" && child === this.robot[layer].group) continue;
      this.groups[layer].remove(child);
      dispose(child);
    }
    this.boxes[layer] = null;
    this.points[layer] = 0;
    if (layer === "live") {
      this.track.length = 0;
      this.trackLine = null;
    }
  }

  private showTrack(): void {
    if (this.trackLine) {
      this.groups.live.remove(this.trackLine);
      dispose(this.trackLine);
    }
    if (this.track.length < 2) return;
    const geometry = new THREE.BufferGeometry().setFromPoints(this.track);
    this.trackLine = new THREE.Line(geometry, new THREE.LineBasicMaterial({ color: 0x14b8a6 }));
    this.groups.live.add(this.trackLine);
    const box = new THREE.Box3().setFromPoints(this.track);
    this.boxes.live = this.boxes.live?.union(box) ?? box;
    this.fit("live");
  }

  private describe(): void {
    const count = this.points[this.layer];
    const places = this.layer === "map" && this.graph ? `${this.graph.nodes.length} places · ` : "";
    setText(by("map-count"), count ? `${places}${count.toLocaleString()} landmarks` : "");
    const empty = by("scene-empty");
    show(empty, !count && !(this.layer === "live" && this.track.length));
    setText(
      empty,
      this.layer === "map"
        ? "No map is in use: choose one, or record a navigation and build a map from it."
        : this.layer === "live"
          ? "Landmarks appear here when a recorded navigation is finished; with SLAM by ukf while it is recorded."
          : "This navigation has no landmarks: SLAM did not finish.",
    );
  }

  /** Whether all there is lies in the picture; for tests. */
  private isWhole(): boolean {
    const box = this.boxes[this.layer];
    if (!box) return true;
    const corners = [0, 1, 2, 3, 4, 5, 6, 7].map(
      (i) =>
        new THREE.Vector3(i & 1 ? box.max.x : box.min.x, i & 2 ? box.max.y : box.min.y, i & 4 ? box.max.z : box.min.z),
    );
    return corners.every((p) => Math.max(Math.abs(p.project(this.camera).x), Math.abs(p.y)) <= 1);
  }

  private resize(): void {
    const { clientWidth: w, clientHeight: h } = this.host;
    if (!w || !h) return;
    this.renderer.setSize(w, h, false);
    this.camera.aspect = w / h;
    this.camera.updateProjectionMatrix();
    this.frameAll();
  }

  /** For changes that no hand makes: a few pictures a second, so that video and joystick keep the machine. */
  private drawSoon(): void {
    this.soon ||= window.setTimeout(
      () => {
        this.soon = 0;
        this.draw();
      },
      Math.max(DATA_REDRAW_MS, DATA_SHARE * this.pace.lastMs),
    );
  }

  private draw(): void {
    if (this.pending) return;
    this.pending = true;
    this.pace.whenFree(() => requestAnimationFrame(() => this.render()));
  }

  private render(): void {
    this.pending = false;
    const points = this.points[this.layer];
    const share = this.isTurning ? this.pace.share(points) : 1;
    const pixels = this.pixelRatio * (this.isTurning ? this.pace.pixels(points) : 1);
    if (pixels !== this.pixels) {
      this.pixels = pixels;
      this.renderer.setPixelRatio(pixels);
    }
    thinOut(this.groups[this.layer], share);
    setPointSize(pixels * pointSize(points * share));
    this.pace.begin(points * share);
    this.renderer.render(this.scene, this.camera);
    this.pace.end();
    this.labels.place(this.camera, this.layer === "map", this.host);
    this.frames += 1;
    this.host.dataset["frames"] = String(this.frames);
    this.host.dataset["share"] = share.toFixed(3);
    this.host.dataset["whole"] = String(this.isWhole());
  }
}

/** Pixels of the page: fewer points are larger, so that walls look closed. */
function pointSize(points: number): number {
  return points > 60_000 ? 1.4 : points > 15_000 ? 2 : 3.2;
}
