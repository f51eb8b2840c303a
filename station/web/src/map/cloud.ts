// Point clouds as the station sends them (docs/api.md): header of 16 bytes, then 16 bytes per point.
import * as THREE from "three";
import { fetchBytes } from "../link/api";
import { PALETTE } from "../places/colours";

const HEADER_BYTES = 16;
const STRIDE = 16;
export interface Cloud {
  buffer: THREE.InterleavedBuffer;
  first: number;
  total: number;
  source: string;
}

/** Fetch points; there may be none. */
export async function fetchCloud(path: string): Promise<Cloud> {
  const { bytes, source } = await fetchBytes(path);
  const header = new DataView(bytes, 0, HEADER_BYTES);
  const count = header.getUint32(4, true);
  const cloud = { first: header.getUint32(8, true), total: header.getUint32(12, true), source };
  const floats = new Float32Array(bytes, HEADER_BYTES, (count * STRIDE) / 4);
  shuffle(new Uint32Array(bytes, HEADER_BYTES, (count * STRIDE) / 4));
  return { ...cloud, buffer: new THREE.InterleavedBuffer(floats, STRIDE / 4) };
}

/** Mix the points up, so that the first ones of a cloud are a thinner picture of it. The same every time. */
function shuffle(words: Uint32Array): void {
  const width = STRIDE / 4;
  let state = 1;
  for (let i = words.length / width - 1; i > 0; i--) {
    state = (Math.imul(state, 1664525) + 1013904223) >>> 0;
    const j = Math.floor((state / 2 ** 32) * (i + 1));
    for (let k = 0; k < width; k++) swap(words, i * width + k, j * width + k);
  }
}

function swap(words: Uint32Array, a: number, b: number): void {
  [words[a], words[b]] = [words[b] ?? 0, words[a] ?? 0];
}

/** Draw only this share of the points of everything below. */
export function thinOut(scene: THREE.Object3D, share: number): void {
  scene.traverse((part) => {
    if (!(part instanceof THREE.Points)) return;
    const { geometry } = part as THREE.Points;
    geometry.setDrawRange(0, share >= 1 ? Infinity : Math.ceil(geometry.getAttribute("position").count * share));
  });
}

const uniforms = {
  size: { value: 2.2 },
  byPlace: { value: 1 },
  palette: { value: PALETTE.map((c) => new THREE.Color(c).convertLinearToSRGB()) },
};

const material = new THREE.ShaderMaterial({
  uniforms,
  vertexShader: `
    attribute vec4 tint; // r g b, number of the place
    uniform float size; uniform float byPlace; uniform vec3 palette[${PALETTE.length}];
    varying vec3 colour;
    void main() {
      float place = floor(tint.a * 255.0 + 0.5);
      vec3 own = palette[int(mod(place, ${PALETTE.length}.0))];
      colour = (byPlace > 0.5 && place < 254.5) ? mix(tint.rgb, own, 0.7) : tint.rgb;
      vec4 p = modelViewMatrix * vec4(position, 1.0);
      gl_Position = projectionMatrix * p;
      gl_PointSize = clamp(size * 8.0 / -p.z, size, size * 3.0);
    }`,
  fragmentShader: `
    varying vec3 colour;
    void main() {
      vec2 d = gl_PointCoord - 0.5;
      if (dot(d, d) > 0.25) discard;
      gl_FragColor = vec4(colour, 1.0);
    }`,
});

export function setPointSize(pixels: number): void {
  uniforms.size.value = pixels;
}

/** Points in their own colours, or all in one. */
export function toPoints(cloud: Cloud, colour?: number): THREE.Points {
  const geometry = new THREE.BufferGeometry();
  const bytes = new THREE.InterleavedBuffer(new Uint8Array(cloud.buffer.array.buffer, HEADER_BYTES), STRIDE);
  geometry.setAttribute("position", new THREE.InterleavedBufferAttribute(cloud.buffer, 3, 0));
  geometry.setAttribute("tint", new THREE.InterleavedBufferAttribute(bytes, 4, 12, true));
  if (colour !== undefined)
    return new THREE.Points(geometry, new THREE.PointsMaterial({ color: colour, size: 2, sizeAttenuation: false }));
  return new THREE.Points(geometry, material);
}

/** Give back what the graphics card keeps of everything below; what others use too stays. */
export function dispose(scene: THREE.Object3D): void {
  scene.traverse((part) => {
    const { geometry, material: own } = part as Partial<THREE.Mesh>;
    geometry?.dispose();
    for (const one of Array.isArray(own) ? own : own ? [own] : []) {
      if (one === material) continue; // of all clouds
      if (one instanceof THREE.MeshBasicMaterial) one.map?.dispose();
      one.dispose();
    }
  });
}
