"""Painters of procedural textures: rich in corners at all scales, each picture and book spine distinct by its seed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from robot.simulation import texture_furniture as furniture
from robot.simulation import texture_walls as walls
from robot.simulation.texture_strokes import Canvas, ImageArray


@dataclass(frozen=True, slots=True)
class TextureSpec:
    """What to paint: equal specs give equal pixels."""

    kind: str
    seed: int
    width_m: float
    height_m: float
    texels_per_m: float

    @property
    def size_px(self) -> tuple[int, int]:
        return max(4, round(self.width_m * self.texels_per_m)), max(4, round(self.height_m * self.texels_per_m))


def paint(spec: TextureSpec) -> ImageArray:
    """Pixels (H, W, 3) BGR of a texture."""
    width, height = spec.size_px
    rng = np.random.default_rng([spec.seed, sum(map(ord, spec.kind))])
    image = np.empty((height, width, 3), np.uint8)
    PAINTERS[spec.kind](Canvas(image, rng, spec.texels_per_m))
    return image


PAINTERS: dict[str, Callable[[Canvas], None]] = {
    "plain_wall": walls.paint_plain_wall,
    "wallpaper": walls.paint_wallpaper,
    "plaster": walls.paint_plaster_wall,
    "brick": walls.paint_brick_wall,
    "tiled": walls.paint_tiled_wall,
    "planks": walls.paint_planks,
    "floor_tiles": walls.paint_floor_tiles,
    "rug": walls.paint_rug,
    "ceiling": walls.paint_ceiling,
    "wood": furniture.paint_wood,
    "drawers": furniture.paint_drawers,
    "books": furniture.paint_books,
    "fabric": furniture.paint_fabric,
    "box_print": furniture.paint_box_print,
    "poster": furniture.paint_poster,
    "appliance": furniture.paint_appliance,
    "screen": furniture.paint_screen,
    "clothes": furniture.paint_clothes,
    "skin": furniture.paint_skin,
    "leaves": furniture.paint_leaves,
    "checker": furniture.paint_checker,
}
