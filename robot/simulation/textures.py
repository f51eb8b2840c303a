"""Procedural textures: what to paint, how it is lit, and who paints it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from robot.simulation import texture_furniture as furniture
from robot.simulation import texture_plain as plain
from robot.simulation import texture_plain_things as things
from robot.simulation import texture_sticker as sticker
from robot.simulation import texture_walls as walls
from robot.simulation.texture_strokes import Canvas, ImageArray

LAMP_SIZE_M = 0.35  # a lamp is no point: nearer than this it does not get brighter
LIGHT_STEP_PX = 8  # light changes slowly: it is worked out at every eighth texel


@dataclass(frozen=True, slots=True)
class Glow:
    """The light of one lamp on a texture."""

    u_m: float  # foot of the lamp on the texture's plane
    v_m: float
    distance_m: float  # of the lamp from the plane
    intensity: float  # m^2: share of full brightness at 1 m, facing the lamp


@dataclass(frozen=True, slots=True)
class TextureSpec:
    """What to paint: equal specs give equal pixels."""

    kind: str
    seed: int
    width_m: float
    height_m: float
    texels_per_m: float
    ambient: float = 1.0  # brightness without the lamps
    glows: tuple[Glow, ...] = ()
    text: str = ""  # that is printed on it

    @property
    def size_px(self) -> tuple[int, int]:
        return max(4, round(self.width_m * self.texels_per_m)), max(4, round(self.height_m * self.texels_per_m))


def paint(spec: TextureSpec) -> ImageArray:
    """Pixels (H, W, 3) BGR of a texture."""
    width, height = spec.size_px
    rng = np.random.default_rng([spec.seed, sum(map(ord, spec.kind))])
    image = np.empty((height, width, 3), np.uint8)
    PAINTERS[spec.kind](Canvas(image, rng, spec.texels_per_m, spec.text))
    if spec.glows or spec.ambient != 1.0:
        image = np.asarray(cv2.multiply(image, cv2.merge([_light(spec)] * 3), dtype=cv2.CV_8U))
    return image


def _light(spec: TextureSpec) -> npt.NDArray[np.float32]:
    """Brightness (H, W) of each texel. Lambert's law for a small lamp at distance d from the plane: I d / r^3."""
    width, height = spec.size_px
    coarse = (max(2, width // LIGHT_STEP_PX), max(2, height // LIGHT_STEP_PX))
    u, v = ((np.arange(n) + 0.5) / n * size for n, size in zip(coarse, (spec.width_m, spec.height_m), strict=True))
    total = np.full((coarse[1], coarse[0]), spec.ambient)
    for glow in spec.glows:
        square = (u[None, :] - glow.u_m) ** 2 + (v[:, None] - glow.v_m) ** 2 + glow.distance_m**2 + LAMP_SIZE_M**2
        total += glow.intensity * glow.distance_m / square**1.5
    return np.asarray(cv2.resize(total.astype(np.float32), (width, height), interpolation=cv2.INTER_LINEAR))


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
    "white_paint": plain.paint_white_paint,
    "white_ceiling": plain.paint_white_ceiling,
    "laminate": plain.paint_laminate,
    "carpet": plain.paint_carpet,
    "lino": plain.paint_lino,
    "large_tiles": plain.paint_large_tiles,
    "plain_rug": plain.paint_plain_rug,
    "lacquer": plain.paint_lacquer,
    "fronts": plain.paint_fronts,
    "soft_cloth": plain.paint_soft_cloth,
    "curtain": plain.paint_curtain,
    "door_leaf": plain.paint_door_leaf,
    "radiator": plain.paint_radiator,
    "window_day": plain.paint_window_day,
    "window_night": plain.paint_window_night,
    "print": plain.paint_print,
    "socket": plain.paint_socket,
    "dark_glass": plain.paint_dark_glass,
    "lamp_shade": plain.paint_lamp_shade,
    "open_shelf": plain.paint_open_shelf,
    "house_plant": plain.paint_house_plant,
    "spines": things.paint_spines,
    "bottle": things.paint_bottle,
    "bowl": things.paint_bowl,
    "labelled_box": things.paint_labelled_box,
    "toy_box": things.paint_toy_box,
    "patterned_cloth": things.paint_patterned_cloth,
    "wicker": things.paint_wicker,
    "shoe": things.paint_shoe,
    "power_strip": things.paint_power_strip,
    "switch": things.paint_switch,
    "clock": things.paint_clock,
    "note_board": things.paint_note_board,
    "wall_tiles": things.paint_wall_tiles,
    "garment": plain.paint_garment,
    "head": plain.paint_head,
    "sticker": sticker.paint_sticker,
}
