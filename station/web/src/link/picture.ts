// Camera pictures as the station sends them (docs/api.md): a header of 32 bytes, then a JPEG.

const HEADER_BYTES = 32;

export interface Picture {
  seq: number;
  tRobotNs: number;
  /** Of the live camera: its age. Of a replay: the time since the first picture. NaN: unknown. */
  seconds: number;
  image: ImageBitmap;
}

export async function decodePicture(data: ArrayBuffer): Promise<Picture> {
  const header = new DataView(data, 0, HEADER_BYTES);
  const jpeg = new Blob([new Uint8Array(data, HEADER_BYTES)], { type: "image/jpeg" });
  return {
    seq: header.getUint32(0, true),
    tRobotNs: Number(header.getBigInt64(8, true)),
    seconds: header.getFloat64(16, true),
    image: await createImageBitmap(jpeg),
  };
}

/** Show it on a canvas, which takes its size. */
export function drawPicture(context: CanvasRenderingContext2D, image: ImageBitmap): void {
  const { canvas } = context;
  if (canvas.width !== image.width || canvas.height !== image.height) {
    canvas.width = image.width;
    canvas.height = image.height;
  }
  context.drawImage(image, 0, 0);
}
