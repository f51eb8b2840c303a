// What was seen of the board, drawn over the live picture.
import type { BoardSeenModel } from "../link/messages";

const CELLS = 3;

/** The newest picture of `video` on this canvas, darker where the board is still to be shown, with the corners found. */
export function drawLooking(
  context: CanvasRenderingContext2D,
  video: HTMLCanvasElement,
  seen: BoardSeenModel | null,
): void {
  const { canvas } = context;
  if (canvas.width !== video.width || canvas.height !== video.height) {
    canvas.width = video.width;
    canvas.height = video.height;
  }
  context.drawImage(video, 0, 0);
  if (!seen) return;
  drawCells(context, seen.cells);
  context.fillStyle = seen.is_taken ? "#34d399" : "#fbbf24";
  const radius = canvas.width / 200;
  for (const [u = 0, v = 0] of seen.corners_px) {
    context.beginPath();
    context.arc(u, v, radius, 0, 2 * Math.PI);
    context.fill();
  }
}

/** Cells that are not full are covered by a veil that thins, and framed. */
function drawCells(context: CanvasRenderingContext2D, cells: number[]): void {
  const width = context.canvas.width / CELLS;
  const height = context.canvas.height / CELLS;
  cells.forEach((fullness, i) => {
    const x = (i % CELLS) * width;
    const y = Math.floor(i / CELLS) * height;
    context.fillStyle = `rgba(4, 12, 20, ${(0.55 * (1 - fullness)).toFixed(2)})`;
    context.fillRect(x, y, width, height);
    context.strokeStyle = fullness >= 1 ? "rgba(52, 211, 153, 0.35)" : "rgba(255, 255, 255, 0.25)";
    context.lineWidth = 1;
    context.strokeRect(x + 0.5, y + 0.5, width - 1, height - 1);
  });
}
