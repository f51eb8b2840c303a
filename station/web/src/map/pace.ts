// How much a turning view may draw so that it follows the hand; at rest everything is drawn.
const TURNING_MS = 40; // for the points of one picture; the rest of the page needs some 20 ms more where the processor draws
const MIN_POINTS = 6000; // fewer show no shape
const COARSE_FROM = 20_000; // smaller clouds are quick with sharp pixels too
const COARSE_PIXELS = 0.5;
const POLL_MS = 4;
const GIVE_UP_MS = 2000; // a lost context never finishes

export class Pace {
  private msPerPoint = 0; // learned from the pictures so far
  private beganMs = 0;
  private drawn = 0;
  private fence: WebGLSync | null = null;
  private next: (() => void) | null = null;
  lastMs = 0; // what the last picture took

  constructor(
    private readonly gl: WebGL2RenderingContext,
    private readonly software: boolean,
  ) {}

  /** Run this when the picture before is drawn: what piles up in the graphics queue follows the hand late. */
  whenFree(draw: () => void): void {
    if (this.fence) this.next = draw;
    else draw();
  }

  /** The share of so many points that a turning view may draw. */
  share(points: number): number {
    const wanted = TURNING_MS / Math.max(1e-9, this.msPerPoint * points);
    return Math.min(1, Math.max(wanted, MIN_POINTS / Math.max(1, points)));
  }

  /** Pixels of the picture per pixel of the page, as a factor. */
  pixels(points: number): number {
    return this.software && points > COARSE_FROM ? COARSE_PIXELS : 1;
  }

  begin(points: number): void {
    this.beganMs = performance.now();
    this.drawn = points;
  }

  /** The picture is on its way to the graphics queue. */
  end(): void {
    this.fence = this.gl.fenceSync(this.gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    this.gl.flush();
    setTimeout(() => this.poll(), POLL_MS);
  }

  private poll(): void {
    const tookMs = performance.now() - this.beganMs;
    const isDone = !this.fence || this.gl.getSyncParameter(this.fence, this.gl.SYNC_STATUS) === this.gl.SIGNALED;
    if (!isDone && tookMs < GIVE_UP_MS) {
      setTimeout(() => this.poll(), POLL_MS);
      return;
    }
    this.gl.deleteSync(this.fence);
    this.fence = null;
    this.lastMs = tookMs;
    const perPoint = tookMs / Math.max(this.drawn, MIN_POINTS);
    this.msPerPoint = this.msPerPoint ? (this.msPerPoint + perPoint) / 2 : perPoint;
    const next = this.next;
    this.next = null;
    next?.();
  }
}

/** Whether the machine's processor draws: there, smooth edges cost four times the work. */
export function isSoftware(): boolean {
  const gl = document.createElement("canvas").getContext("webgl2");
  const info = gl?.getExtension("WEBGL_debug_renderer_info");
  const name = gl && info ? String(gl.getParameter(info.UNMASKED_RENDERER_WEBGL)) : "";
  gl?.getExtension("WEBGL_lose_context")?.loseContext();
  return /swiftshader|llvmpipe|software/i.test(name);
}
