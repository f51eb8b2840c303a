// The place graph in the 3D view: lines with bearings, names of places.
import * as THREE from "three";
import type { EdgeModel, GraphModel, PlaceModel } from "../link/messages";
import { colourOf } from "../places/colours";
import { make } from "../ui/dom";
import { dispose } from "./cloud";
import type { Labels } from "./labels";

const NAMED = 1e9; // landmarks: more than any place has, so that what a person named is read first

export class Graph3d {
  private lines: THREE.LineSegments | null = null;

  constructor(private readonly labels: Labels) {}

  /** Show this graph, or none, instead of the one before. */
  show(graph: GraphModel | null, group: THREE.Group, onPlace: (place: PlaceModel) => void): void {
    if (this.lines) {
      this.lines.removeFromParent();
      dispose(this.lines);
    }
    this.lines = null;
    const edges = graph ? edgesOf(graph) : [];
    this.labels.replace(() => graph && this.write(graph, edges, onPlace));
    if (!graph) return;
    this.lines = new THREE.LineSegments(
      new THREE.BufferGeometry().setFromPoints(edges.flatMap(({ ends }) => ends)),
      new THREE.LineBasicMaterial({ color: 0x94a3b8, transparent: true, opacity: 0.75 }),
    );
    group.add(this.lines);
  }

  private write(graph: GraphModel, edges: Edge3d[], onPlace: (place: PlaceModel) => void): void {
    for (const { edge, ends } of edges) {
      const degrees = Math.round((edge.bearing_rad * 180) / Math.PI);
      const text = graph.metric ? `${degrees}° · ${edge.distance.toFixed(1)} m` : `${degrees}°`;
      this.labels.add(make("span", { class: "bearing" }, text), ends[0].clone().lerp(ends[1], 0.5), -edge.distance);
    }
    for (const node of graph.nodes) {
      const button = make(
        "button",
        { type: "button", class: "place-label", "data-place": node.id, title: node.name },
        make("span", {}, node.name),
      );
      button.dataset.named = String(node.named);
      button.style.setProperty("--own", colourOf(node.colour));
      button.addEventListener("click", () => onPlace(node));
      this.labels.add(button, centroid(node), node.landmarks + (node.named ? NAMED : 0));
    }
  }
}

interface Edge3d {
  edge: EdgeModel;
  ends: [THREE.Vector3, THREE.Vector3];
}

function edgesOf(graph: GraphModel): Edge3d[] {
  const at = new Map(graph.nodes.map((node) => [node.id, centroid(node)]));
  return graph.edges.flatMap((edge) => {
    const [a, b] = [at.get(edge.a), at.get(edge.b)];
    return a && b ? [{ edge, ends: [a, b] }] : []; // the station sends no edge of other places
  });
}

/** The middle of a place. */
export function centroid(place: PlaceModel): THREE.Vector3 {
  return new THREE.Vector3().fromArray(place.centroid_map);
}
