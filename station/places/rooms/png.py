"""A floor plan as PNG."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from shared.geometry import FloatArray
from station.model.floor_plan import FloorPlan
from station.model.place_map import PlaceMap
from station.places.rooms.drawing import Colour, Drawing, DrawnDoor, DrawnRoom, draw_plan

PX_PER_M = 100
MAX_SIDE_PX = 4000
WALL_M = 0.1
INK, PATH, PLACE, FURNITURE = (43, 47, 54), (150, 160, 175), (194, 65, 12), (178, 184, 192)
WHITE = (255, 255, 255)
SUBPIXEL_BITS = 4  # OpenCV's fixed-point coordinates


def floorplan_png(plan: FloorPlan, place_map: PlaceMap | None = None) -> bytes:
    """The plan with y up; places and path where a map is given. At most MAX_SIDE_PX wide and high."""
    drawing = draw_plan(plan, place_map)
    page = _Page(drawing)
    for room in drawing.rooms:
        page.fill(room.outlines, room.colour)
    page.boxes(drawing.furniture, FURNITURE)
    for piece in drawing.path:
        page.line(piece, PATH, 0.02)
    for wall in drawing.walls:
        page.line(wall, INK, WALL_M)
    for door in drawing.doors:
        page.door(door)
    for at, _ in drawing.places:
        page.dot(at)
    for room in drawing.rooms:
        page.label(room)
    if drawing.scale_m:
        page.scale_bar(drawing.scale_m)
    done, encoded = cv2.imencode(".png", page.image[..., ::-1])
    assert done
    return encoded.tobytes()


class _Page:
    """An RGB picture that is drawn on in metres with y up."""

    def __init__(self, drawing: Drawing) -> None:
        size = drawing.high - drawing.low
        self.scale = min(PX_PER_M, MAX_SIDE_PX / float(size.max()))
        width, height = np.ceil(size * self.scale).astype(int).tolist()
        self.image: npt.NDArray[np.uint8] = np.full((height, width, 3), 255, dtype=np.uint8)
        self._corner = np.array([drawing.low[0], drawing.high[1]])
        self._font = cv2.FontFace("sans")

    def px(self, p: FloatArray) -> FloatArray:
        return np.asarray((p - self._corner) * (self.scale, -self.scale))

    def _fixed(self, p: FloatArray) -> npt.NDArray[np.int32]:
        return np.round(self.px(p) * (1 << SUBPIXEL_BITS)).astype(np.int32).reshape(-1, 1, 2)

    def fill(self, outlines: tuple[FloatArray, ...], colour: Colour) -> None:
        if outlines:
            cv2.fillPoly(self.image, [self._fixed(o) for o in outlines], colour, cv2.LINE_AA, SUBPIXEL_BITS)

    def boxes(self, boxes: FloatArray, colour: Colour) -> None:
        low, high = self.px(boxes[:, [0, 3]]), self.px(boxes[:, [2, 1]])
        for (x0, y0), (x1, y1) in zip(
            np.round(low).astype(int).tolist(), np.round(high).astype(int).tolist(), strict=True
        ):
            self.image[max(y0, 0) : max(y1, 0), max(x0, 0) : max(x1, 0)] = colour

    def line(self, p: FloatArray, colour: Colour, width_m: float) -> None:
        if len(p) > 1:
            thick = max(1, round(width_m * self.scale))
            cv2.polylines(self.image, [self._fixed(p)], False, colour, thick, cv2.LINE_AA, SUBPIXEL_BITS)

    def dot(self, at: FloatArray) -> None:
        x, y = self._fixed(at[None])[0, 0].tolist()
        radius = max(2, round(0.05 * self.scale)) << SUBPIXEL_BITS
        cv2.circle(self.image, (x, y), radius, PLACE, -1, cv2.LINE_AA, SUBPIXEL_BITS)

    def door(self, door: DrawnDoor) -> None:
        self.line(door.ends, WHITE, 1.6 * WALL_M)
        if len(door.swing):
            self.line(np.stack([door.ends[0], door.swing[-1]]), INK, 0.02)
            self.line(door.swing, INK, 0.015)
            return
        steps = np.linspace(0.0, 1.0, 2 * max(2, round(float(np.linalg.norm(np.diff(door.ends, axis=0))) / 0.16)) + 1)
        p = door.ends[0] + steps[:, None] * (door.ends[1] - door.ends[0])
        for k in range(0, len(p) - 1, 2):
            self.line(p[k : k + 2], INK, 0.02)

    def label(self, room: DrawnRoom) -> None:
        x, y = self.px(room.middle).tolist()
        size = max(8, round(room.text_m * self.scale))
        self._text(room.label, x, y, size)
        if room.area:
            self._text(room.area, x, y + 1.25 * size, max(8, round(0.75 * size)))

    def _text(self, text: str, x: float, y: float, size: int) -> None:
        width = cv2.getTextSize((0, 0), text, (0, 0), self._font, size)[2]
        cv2.putText(self.image, text, (round(x - width / 2), round(y)), INK, self._font, size)

    def scale_bar(self, length_m: float) -> None:
        y, end = self.image.shape[0] - 18, 18 + round(length_m * self.scale)
        cv2.line(self.image, (18, y), (end, y), INK, 2, cv2.LINE_AA)
        for x in (18, end):
            cv2.line(self.image, (x, y - 5), (x, y + 5), INK, 2, cv2.LINE_AA)
        cv2.putText(self.image, f"{length_m:g} m", (end + 10, y + 6), INK, self._font, 18)
