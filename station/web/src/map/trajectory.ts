// The way that a robot went.
import * as THREE from "three";

export function toLine(trajectory: THREE.Vector3[]): THREE.Line {
  const geometry = new THREE.BufferGeometry().setFromPoints(trajectory);
  return new THREE.Line(geometry, new THREE.LineBasicMaterial({ color: 0x14b8a6 }));
}
