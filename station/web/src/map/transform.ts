// Rigid motions and similarities as the station sends them: 16 numbers of a 4x4 matrix, row by row.
import * as THREE from "three";

export function toMatrix(T: number[]): THREE.Matrix4 {
  return new THREE.Matrix4().fromArray(T).transpose();
}

/** Where it moves the origin. */
export function positionOf(T: number[]): THREE.Vector3 {
  return new THREE.Vector3(T[3], T[7], T[11]);
}
