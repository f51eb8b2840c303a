// The live picture: newest frame wins, each one acknowledged, its age measured.
import { decodePicture, drawPicture } from "../link/picture";
import { LastingSocket } from "../link/socket";
import { by, context2d, setText, show } from "../ui/dom";
import { STALE_MS } from "./safety";

export class VideoView {
  readonly canvas = by("video", HTMLCanvasElement);
  private readonly context = context2d(this.canvas, { alpha: false, desynchronized: true });
  private readonly socket: LastingSocket;
  private ageAtArrivalMs = 0;
  private arrivedMs = -Infinity;
  onPicture: () => void = () => undefined; // one was drawn

  constructor() {
    this.socket = new LastingSocket("/ws/camera", { onMessage: (data) => void this.take(data as ArrayBuffer) });
    setInterval(() => this.refresh(), 100);
  }

  /** How old the shown picture is now; since its arrival where the clocks are unknown. Infinity: none has come yet. */
  get ageMs(): number {
    return this.ageAtArrivalMs + performance.now() - this.arrivedMs;
  }

  private async take(data: ArrayBuffer): Promise<void> {
    const arrivedMs = performance.now();
    try {
      const picture = await decodePicture(data);
      drawPicture(this.context, picture.image);
      picture.image.close();
      this.ageAtArrivalMs = Number.isFinite(picture.seconds) ? picture.seconds * 1000 : 0;
      this.arrivedMs = arrivedMs;
      this.canvas.dataset.seq = String(picture.seq);
    } catch {
      return; // one picture that cannot be decoded must not end the video
    } finally {
      this.socket.send("next");
    }
    this.onPicture();
  }

  private refresh(): void {
    const age = by("age");
    const ms = this.ageMs;
    const hasPicture = ms < Infinity;
    show(by("video-empty"), !hasPicture);
    show(age, hasPicture);
    if (!hasPicture) return;
    setText(age, ms < 1000 ? `${Math.round(ms / 10) * 10} ms` : `${(ms / 1000).toFixed(ms < 10000 ? 1 : 0)} s old`);
    age.classList.toggle("bad", ms > STALE_MS);
    this.canvas.classList.toggle("stale", ms > 2 * STALE_MS);
  }
}
