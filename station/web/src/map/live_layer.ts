// The running or last navigation: its landmarks, the way it went, and the robot in it.
import * as THREE from "three";
import { call } from "../link/api";
import type { SlamModel, TrajectoryModel } from "../link/messages";
import { Refresh } from "../link/refresh";
import { Camera3d } from "./camera";
import { dispose, fetchCloud } from "./cloud";
import { type LayerEvents, SceneLayer } from "./layer";
import { toLine } from "./trajectory";
import { positionOf } from "./transform";

const MAX_CHUNKS = 40; // then the cloud is fetched whole again: fewer, larger buffers draw faster
const STEP_M = 0.02; // of the trajectory

export interface LiveLayerEvents extends LayerEvents {
  /** The cloud was fetched from its beginning. */
  onAnew: () => void;
}

export class LiveLayer extends SceneLayer {
  readonly emptyText =
    "Landmarks appear here when a recorded navigation is finished; with SLAM by ukf while it is recorded.";
  override readonly robot: THREE.Group;
  private readonly camera: Camera3d;
  private readonly content = new Refresh(() => this.fetch());
  private shown = { navigation: "", total: 0, chunks: 0 };
  private wanted = { navigation: "", total: 0 };
  private trajectory: THREE.Vector3[] = [];
  private line: THREE.Line | null = null;

  constructor(
    video: HTMLCanvasElement,
    protected override readonly events: LiveLayerEvents,
  ) {
    super(events);
    this.camera = new Camera3d(video);
    this.robot = this.camera.group;
    this.group.add(this.robot);
  }

  override get isEmpty(): boolean {
    return super.isEmpty && !this.trajectory.length;
  }

  /** There are new landmarks, or another navigation runs. */
  update(source: string | null, total: number): Promise<void> {
    this.wanted = { navigation: source ?? "", total };
    return this.content.ask();
  }

  showSlam(slam: SlamModel): void {
    this.camera.place(slam.T_world_cam);
    const T = slam.T_world_body;
    if (!T || slam.navigation !== this.shown.navigation || slam.state === "finished") return;
    const p = positionOf(T);
    const last = this.trajectory.at(-1);
    if (last && last.distanceTo(p) <= STEP_M) return;
    this.trajectory.push(p);
    this.drawTrajectory();
  }

  override clear(): void {
    super.clear();
    this.trajectory = [];
    this.line = null;
  }

  private async fetch(): Promise<void> {
    const { shown, wanted } = this;
    const isNew = wanted.navigation !== shown.navigation || wanted.total < shown.total || shown.chunks > MAX_CHUNKS;
    if (!isNew && wanted.total === shown.total) return;
    const since = isNew ? 0 : shown.total;
    const cloud = await fetchCloud(`/landmarks?since=${since}&navigation=${encodeURIComponent(shown.navigation)}`);
    const isWhole = isNew || cloud.first === 0;
    if (isWhole) {
      const trajectory = await call<TrajectoryModel>("GET", "/trajectory?limit=4000");
      if ((trajectory.source ?? "") !== cloud.source) return; // another one began, or this one is finished: its event is on the way
      this.clear();
      this.trajectory = trajectory.p_world.map((p) => new THREE.Vector3().fromArray(p));
      this.drawTrajectory();
    }
    this.shown = { navigation: cloud.source, total: cloud.total, chunks: isWhole ? 1 : shown.chunks + 1 };
    this.addCloud(cloud);
    if (isNew) this.events.onAnew();
  }

  private drawTrajectory(): void {
    if (this.line) {
      this.group.remove(this.line);
      dispose(this.line);
    }
    if (this.trajectory.length < 2) return;
    this.line = toLine(this.trajectory);
    this.group.add(this.line);
    this.grow(new THREE.Box3().setFromPoints(this.trajectory));
  }
}
