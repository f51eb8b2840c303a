// The live picture: newest frame wins, each one acknowledged, its age measured.
import { LastingSocket } from "../link/socket";
import { by, setText, show } from "../ui/dom";

const HEADER_BYTES = 32;
export const STALE_MS = 500;

export class VideoView {
  readonly canvas = by<HTMLCanvasElement>("video");
  private readonly context = this.canvas.getContext("2d", { alpha: false, desynchronized: true })!;
  private readonly socket: LastingSocket;
  private ageAtArrivalMs = 0;
  private arrivedMs = -Infinity;
  frames = 0;
  onFrame: () => void = () => {};

  constructor() {
    this.socket = new LastingSocket(
      "/ws/camera",
      (data) => void this.take(data as ArrayBuffer),
      () => {},
    );
    setInterval(() => this.refresh(), 100);
  }

  get hasPicture(): boolean {
    return this.frames > 0;
  }

  /** How old the shown picture is now; since its arrival where the clocks are unknown. */
  get ageMs(): number {
    return this.ageAtArrivalMs + performance.now() - this.arrivedMs;
  }

  get isStale(): boolean {
    return this.ageMs > STALE_MS;
  }

  private async take(data: ArrayBuffer): Promise<void> {
    const header = new DataView(data, 0, HEADER_BYTES);
    const arrivedMs = performance.now();
    const ageS = header.getFloat64(16, true);
    try {
      const picture = await createImageBitmap(new Blob([new Uint8Array(data, HEADER_BYTES)], { type: "image/jpeg" }));
      if (this.canvas.width !== picture.width || this.canvas.height !== picture.height) {
        this.canvas.width = picture.width;
        this.canvas.height = picture.height;
      }
      this.context.drawImage(picture, 0, 0);
      picture.close();
      this.ageAtArrivalMs = Number.isFinite(ageS) ? ageS * 1000 : 0;
      this.arrivedMs = arrivedMs;
      this.frames += 1;
      this.canvas.dataset["seq"] = String(header.getUint32(0, true));
      this.onFrame();
    } catch {
      // One picture that cannot be decoded must not end the video.
    } finally {
      this.socket.send("next");
    }
  }

  private refresh(): void {
    const age = by("age");
    show(by("video-empty"), !this.hasPicture);
    show(age, this.hasPicture);
    if (!this.hasPicture) return;
    const ms = this.ageMs;
    setText(age, ms < 1000 ? `${Math.round(ms / 10) * 10} ms` : `${(ms / 1000).toFixed(ms < 10000 ? 1 : 0)} s old`);
    age.classList.toggle("bad", ms > STALE_MS);
    this.canvas.classList.toggle("stale", ms > 2 * STALE_MS);
  }
}
