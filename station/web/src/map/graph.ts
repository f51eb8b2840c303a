// The place graph in the 3D view: lines with bearings, names of places.
import * as THREE from "three";
import type { GraphModel, PlaceModel } from "../link/messages";
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
    this.labels.clear();
    if (!graph) return;
    const at = new Map(graph.nodes.map((node) => [node.id, centroid(node)]));
    const ends: THREE.Vector3[] = [];
    for (const edge of graph.edges) {
      const [a, b] = [at.get(edge.a), at.get(edge.b)];
      if (!a || !b) continue; // the station sends no such edge
      ends.push(a, b);
      const degrees = Math.round((edge.bearing_rad * 180) / Math.PI);
      const text = graph.metric ? `${degrees}° · ${edge.distance.toFixed(1)} m` : `${degrees}°`;
      this.labels.add(make("span", { class: "bearing" }, text), a.clone().lerp(b, 0.5), -edge.distance);
    }
    this.lines = new THREE.LineSegments(
      new THREE.BufferGeometry().setFromPoints(ends),
      new THREE.LineBasicMaterial({ color: 0x94a3b8, transparent: true, opacity: 0.75 }),
    );
    group.add(this.lines);
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

/** The middle of a place. */
export function centroid(place: PlaceModel): THREE.Vector3 {
  return new THREE.Vector3().fromArray(place.centroid_map);
}
