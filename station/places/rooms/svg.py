"""A floor plan as SVG."""

from __future__ import annotations

from html import escape

import numpy as np

from shared.geometry import FloatArray
from station.model.floor_plan import FloorPlan
from station.model.place_map import PlaceMap
from station.places.rooms.drawing import Drawing, DrawnDoor, DrawnRoom, draw_plan

PX_PER_M = 80
WALL_M = 0.1
INK, PATH, PLACE, FURNITURE = "#2b2f36", "#7a8596", "#c2410c", "#9aa3ad"


def floorplan_svg(plan: FloorPlan, place_map: PlaceMap | None = None) -> bytes:
    """The plan with y up; places and path where a map is given. Elements carry `data-id` of what they show."""
    drawing = draw_plan(plan, place_map)
    page = _Page(drawing)
    width, height = ((drawing.high - drawing.low) * PX_PER_M).tolist()
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:.0f} {height:.0f}" '
        f'width="{width:.0f}" height="{height:.0f}" font-family="sans-serif">',
        f'<rect width="{width:.0f}" height="{height:.0f}" fill="#ffffff"/>',
        *(page.room(room) for room in drawing.rooms),
        f'<path class="furniture" fill="{FURNITURE}" fill-opacity="0.6" d="{page.boxes(drawing.furniture)}"/>',
        *(page.path(piece) for piece in drawing.path if len(piece) > 1),
        f'<path class="walls" fill="none" stroke="{INK}" stroke-width="{WALL_M * PX_PER_M:.1f}" '
        f'stroke-linecap="square" d="{page.lines(drawing.walls)}"/>',
        *(page.door(door) for door in drawing.doors),
        *(page.place(at, name) for at, name in drawing.places),
        *(page.label(room) for room in drawing.rooms),
        page.scale_bar(drawing.scale_m, height) if drawing.scale_m else "",
        "</svg>",
    ]
    return "\n".join(part for part in parts if part).encode()


class _Page:
    """Metres with y up to the pixels of a page with y down."""

    def __init__(self, drawing: Drawing) -> None:
        self._left, self._top = float(drawing.low[0]), float(drawing.high[1])

    def xy(self, p: FloatArray) -> FloatArray:
        return np.asarray((p - (self._left, self._top)) * (PX_PER_M, -PX_PER_M))

    def points(self, p: FloatArray) -> str:
        return " ".join(f"{x:.1f},{y:.1f}" for x, y in self.xy(p).tolist())

    def lines(self, segments: FloatArray) -> str:
        flat = self.xy(segments.reshape(-1, 2)).reshape(-1, 4).tolist()
        return "".join(f"M{a:.1f} {b:.1f}L{c:.1f} {d:.1f}" for a, b, c, d in flat)

    def boxes(self, boxes: FloatArray) -> str:
        low, high = self.xy(boxes[:, :2]), self.xy(boxes[:, 2:])
        flat = np.column_stack([low, high - low]).tolist()
        return "".join(f"M{x:.1f} {y:.1f}h{w:.1f}v{h:.1f}h{-w:.1f}z" for x, y, w, h in flat)

    def room(self, room: DrawnRoom) -> str:
        fill = "#{:02x}{:02x}{:02x}".format(*room.colour)
        d = "".join(f"M{self.points(outline).replace(' ', 'L')}z" for outline in room.outlines)
        title = f"<title>{escape(room.name)}</title>"
        return f'<path class="room" data-id="{escape(room.id)}" fill="{fill}" d="{d}">{title}</path>'

    def label(self, room: DrawnRoom) -> str:
        x, y = self.xy(room.middle).tolist()
        size = room.text_m * PX_PER_M
        around = 'stroke="#ffffff" stroke-width="3" stroke-opacity="0.8" paint-order="stroke"'
        title = f"<title>{escape(room.name)}</title>"
        name = f'<tspan x="{x:.1f}" font-weight="600">{escape(room.label)}</tspan>'
        area = f'<tspan x="{x:.1f}" dy="1.25em" font-size="{0.75 * size:.1f}">{room.area}</tspan>' if room.area else ""
        return (
            f'<text class="room-name" data-id="{escape(room.id)}" x="{x:.1f}" y="{y:.1f}" font-size="{size:.1f}" '
            f'text-anchor="middle" fill="{INK}" {around}>{title}{name}{area}</text>'
        )

    def door(self, door: DrawnDoor) -> str:
        (ax, ay), (bx, by) = self.xy(door.ends).tolist()
        width = f'stroke="#ffffff" stroke-width="{1.6 * WALL_M * PX_PER_M:.1f}"'
        gap = f'<path {width} d="M{ax:.1f} {ay:.1f}L{bx:.1f} {by:.1f}"/>'
        dashes = ' stroke-dasharray="6 5"' if not len(door.swing) else ""
        leaf = door.ends if not len(door.swing) else np.stack([door.ends[0], door.swing[-1]])
        arc = f'<polyline points="{self.points(door.swing)}"/>' if len(door.swing) else ""
        line = f'<polyline points="{self.points(leaf)}"{dashes}/>'
        kind = "door drawn" if door.is_drawn else "door"
        return (
            f'<g class="{kind}" data-id="{escape(door.id)}" fill="none" stroke="{INK}" stroke-width="1.5">'
            f"{gap}{line}{arc}</g>"
        )

    def path(self, piece: FloatArray) -> str:
        return (
            f'<polyline class="path" fill="none" stroke="{PATH}" stroke-width="1.5" stroke-opacity="0.6" '
            f'stroke-dasharray="2 4" points="{self.points(piece)}"/>'
        )

    def place(self, at: FloatArray, name: str) -> str:
        x, y = self.xy(at).tolist()
        title = f"<title>{escape(name)}</title>"
        return f'<circle class="place" cx="{x:.1f}" cy="{y:.1f}" r="4" fill="{PLACE}">{title}</circle>'

    def scale_bar(self, length_m: float, height: float) -> str:
        x, y, end = 14.0, height - 14.0, 14.0 + length_m * PX_PER_M
        ticks = f"M{x:.1f} {y - 5:.1f}v10M{x:.1f} {y:.1f}H{end:.1f}M{end:.1f} {y - 5:.1f}v10"
        return (
            f'<g class="scale"><path fill="none" stroke="{INK}" stroke-width="1.5" d="{ticks}"/>'
            f'<text x="{end + 8:.1f}" y="{y + 5:.1f}" font-size="14" fill="{INK}">{length_m:g} m</text></g>'
        )
