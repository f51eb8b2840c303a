// The active map: its cloud, its places with their names, its graph, and the robot in it.
import type * as THREE from "three";
import { call } from "../link/api";
import type { CurrentPlace, GraphModel, PlaceModel } from "../link/messages";
import { Refresh } from "../link/refresh";
import { by } from "../ui/dom";
import { Camera3d } from "./camera";
import { type Cloud, fetchCloud } from "./cloud";
import { centroid, Graph3d } from "./graph";
import { Labels } from "./labels";
import { type LayerEvents, SceneLayer } from "./layer";

interface MapVersion {
  id: string | null;
  revision: number;
}

interface MapContent {
  graph: GraphModel | null;
  places: PlaceModel[];
  cloud: Cloud | null; // null: the one that is shown already
}

const NO_CONTENT: MapContent = { graph: null, places: [], cloud: null };

export interface MapLayerEvents extends LayerEvents {
  /** The name of a place was clicked. */
  onPlace: (place: PlaceModel) => void;
  /** There are places of another map, or changed ones; hidden ones too. */
  onPlaces: (places: PlaceModel[]) => void;
  /** The active map, or something in it, is another one. */
  onMap: (isOther: boolean) => void;
}

export class MapLayer extends SceneLayer {
  readonly emptyText = "No map is in use: choose one, or record a navigation and build a map from it.";
  override readonly robot: THREE.Group;
  private readonly camera: Camera3d;
  private readonly labels = new Labels(by("labels"));
  private readonly net = new Graph3d(this.labels);
  private readonly content = new Refresh(() => this.fetch());
  private shown: MapVersion = { id: null, revision: -1 };
  private wanted: MapVersion = { id: null, revision: -1 };
  private numPlaces: number | null = null; // null: there is no map
  private currentPlaceId: string | null = null;

  constructor(
    video: HTMLCanvasElement,
    protected override readonly events: MapLayerEvents,
  ) {
    super(events);
    this.camera = new Camera3d(video);
    this.robot = this.camera.group;
    this.group.add(this.robot);
  }

  /** Whether a map is in use, or about to be shown. */
  get hasMap(): boolean {
    return this.wanted.id !== null;
  }

  override get summary(): string {
    return this.points && this.numPlaces !== null ? `${this.numPlaces} places · ${super.summary}` : super.summary;
  }

  /** Show another active map, or its new names. The newest call wins. */
  showMap(id: string | null, revision: number): Promise<void> {
    this.wanted = { id, revision };
    return this.content.ask();
  }

  showPlace(place: CurrentPlace): void {
    const isHere = place.map === this.wanted.id && !place.withheld; // in another active map it is elsewhere
    this.camera.place(isHere ? place.pose_map : null);
    const id = place.place?.id ?? null;
    if (id === this.currentPlaceId) return;
    this.currentPlaceId = id;
    this.labels.setHere(id);
  }

  /** Put the names of places where the camera sees them, or hide them all. */
  placeLabels(camera: THREE.Camera, areShown: boolean, scene: HTMLElement): void {
    this.labels.place(camera, areShown, scene);
  }

  private async fetch(): Promise<void> {
    const wanted = this.wanted;
    if (wanted.id === null) {
      this.take(wanted, NO_CONTENT);
      return;
    }
    const isNew = wanted.id !== this.shown.id || wanted.revision !== this.shown.revision;
    try {
      const [graph, places, cloud] = await Promise.all([
        call<GraphModel>("GET", "/graph"),
        call<PlaceModel[]>("GET", "/places"),
        isNew ? fetchCloud(`/maps/${wanted.id}/landmarks`) : null,
      ]);
      // Another one's graph: it was chosen meanwhile, and its event is on the way.
      if (this.wanted === wanted && graph.map === wanted.id) this.take(wanted, { graph, places, cloud });
    } catch (error) {
      if (this.wanted === wanted) throw error; // of a map that nobody wants any more it means nothing
    }
  }

  private take(version: MapVersion, { graph, places, cloud }: MapContent): void {
    const isOther = version.id !== this.shown.id;
    this.shown = version;
    this.numPlaces = graph?.nodes.length ?? null;
    this.events.onPlaces(places);
    if (isOther || cloud) {
      this.clear();
      if (cloud) this.addCloud(cloud);
    }
    for (const node of graph?.nodes ?? []) this.space?.expandByPoint(centroid(node)); // it may lie beside its cloud
    this.net.show(graph, this.group, this.events.onPlace);
    this.labels.setHere(this.currentPlaceId);
    this.events.onMap(isOther);
  }
}
