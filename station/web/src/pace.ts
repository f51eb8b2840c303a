// How much a turning view may draw so that it follows the hand; at rest everything is drawn.
const SLOW_MS = 50; // from asking for a picture until the browser is ready to draw it
const QUICK_MS = 25;
const MIN_POINTS = 8000;

export class Pace {
  private askedMs = 0;
  private learned = 1;

  /** A picture was asked for; the browser makes it wait while it still works on the ones before. */
  asked(): void {
    this.askedMs = performance.now();
  }

  /** The share of so many points that may be drawn now. */
  share(points: number): number {
    const waitedMs = performance.now() - this.askedMs;
    if (waitedMs > SLOW_MS) this.learned *= Math.max(0.4, SLOW_MS / waitedMs);
    else if (waitedMs < QUICK_MS) this.learned *= 1.15;
    this.learned = Math.min(1, Math.max(Math.min(1, MIN_POINTS / Math.max(1, points)), this.learned));
    return this.learned;
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
