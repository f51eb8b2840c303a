// A recorded navigation again: its pictures in a corner of the 3D view, its cloud and way, the camera where it was.
import * as THREE from "three";
import { socketUrl } from "../link/address";
import { call } from "../link/api";
import type { NavigationModel, ReplayModel } from "../link/messages";
import { decodePicture, drawPicture, type Picture } from "../link/picture";
import { Camera3d } from "../map/camera";
import { fetchCloud, toPoints } from "../map/cloud";
import { extent } from "../map/extent";
import { toLine } from "../map/trajectory";
import { positionOf } from "../map/transform";
import type { MapView } from "../map/view";
import { by, context2d, setText, show } from "../ui/dom";
import { duration } from "../ui/text";

const MAX_POSE_GAP_S = 1;

export class Replay {
  private readonly canvas = by("replay-video", HTMLCanvasElement);
  private readonly context = context2d(this.canvas);
  private readonly seek = by("seek", HTMLInputElement);
  private socket: WebSocket | null = null;
  private navigation: NavigationModel | null = null;
  private poses: ReplayModel | null = null;
  private camera: Camera3d | null = null;
  private opened = 0; // counts openings: an answer for an earlier one is too late

  constructor(private readonly map: MapView | null) {
    by("play").addEventListener("click", () => (this.socket ? this.pause() : this.play()));
    this.seek.addEventListener("change", () => this.play());
    this.seek.addEventListener("input", () => this.showTime());
  }

  async open(navigation: NavigationModel): Promise<void> {
    const turn = ++this.opened;
    this.pause();
    this.navigation = navigation;
    this.poses = null;
    this.camera = null;
    const base = `/navigations/${navigation.id}`;
    const isReady = navigation.state === "ready";
    const [poses, cloud] = isReady
      ? await Promise.all([call<ReplayModel>("GET", `${base}/replay`), fetchCloud(`${base}/landmarks`)])
      : [null, null];
    if (turn !== this.opened) return;
    this.poses = poses;
    const content = new THREE.Group();
    if (cloud?.buffer.count) content.add(toPoints(cloud));
    if (poses && poses.T_world_cam.length > 1) content.add(toLine(poses.T_world_cam.map(positionOf)));
    this.camera = new Camera3d(this.canvas);
    content.add(this.camera.group);
    this.map?.openReview(content, cloud && extent(cloud), cloud?.total ?? 0);
    this.seek.max = String(Math.max(navigation.duration_s, 0.1));
    this.seek.value = "0";
    show(this.canvas, true);
    this.play();
  }

  close(): void {
    this.opened += 1;
    this.pause();
    this.navigation = null;
    show(this.canvas, false);
  }

  private play(): void {
    const navigation = this.navigation;
    if (!navigation) return;
    this.pause();
    const end = Number(this.seek.max);
    if (Number(this.seek.value) > end - 0.2) this.seek.value = "0";
    const socket = new WebSocket(
      socketUrl(`/ws/replay?navigation=${encodeURIComponent(navigation.id)}&from_s=${this.seek.value}`),
    );
    socket.binaryType = "arraybuffer";
    socket.onmessage = (event) => void this.take(socket, event.data as ArrayBuffer);
    socket.onclose = () => {
      if (this.socket === socket) this.pause();
    };
    this.socket = socket;
    setText(by("play"), "Pause");
  }

  private pause(): void {
    this.socket?.close();
    this.socket = null;
    setText(by("play"), "Play");
  }

  private async take(socket: WebSocket, data: ArrayBuffer): Promise<void> {
    try {
      const picture = await decodePicture(data);
      if (this.socket === socket) this.draw(picture);
      picture.image.close();
    } catch {
      // One picture that cannot be decoded must not end the replay.
    }
    if (socket.readyState === WebSocket.OPEN) socket.send("next");
  }

  private draw({ image, tRobotNs, seconds }: Picture): void {
    drawPicture(this.context, image);
    this.canvas.dataset.shown = String(Number(this.canvas.dataset.shown ?? "0") + 1);
    if (document.activeElement !== this.seek || !this.seek.matches(":active")) this.seek.value = String(seconds);
    this.showTime();
    this.camera?.place(this.poseAt(tRobotNs));
    this.map?.redraw();
  }

  /** Where the camera was then; null where no pose is near in time. */
  private poseAt(tRobotNs: number): number[] | null {
    if (!this.poses) return null;
    const t = (tRobotNs - this.poses.start_ns) * 1e-9;
    let nearest: number | null = null;
    let gap = MAX_POSE_GAP_S;
    for (const [i, tPose] of this.poses.t_s.entries()) {
      if (Math.abs(tPose - t) > gap) continue;
      gap = Math.abs(tPose - t);
      nearest = i;
    }
    return nearest === null ? null : (this.poses.T_world_cam[nearest] ?? null);
  }

  private showTime(): void {
    setText(by("replay-time"), `${duration(Number(this.seek.value))} of ${duration(Number(this.seek.max))}`);
  }
}
