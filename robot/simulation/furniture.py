"""Pieces of furniture made of textured boxes. Each piece stands with its back at local y = 0, looking along +y."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from robot.simulation.building import Builder, Pose2, TexturePicker
from robot.simulation.textures import TextureSpec

Look = tuple[str, float]  # kind of texture, texels per m


@dataclass(frozen=True, slots=True)
class Piece:
    name: str
    width_m: tuple[float, float]
    depth_m: float
    build: Callable[[Site], None]


@dataclass(frozen=True, slots=True)
class Site:
    builder: Builder
    pick: TexturePicker
    rng: np.random.Generator
    pose: Pose2  # middle of the piece's back edge
    width_m: float
    depth_m: float
    room: int
    name: str

    def box(
        self,
        x_m: float,
        y_m: float,
        size_m: tuple[float, float, float],
        z0_m: float,
        front: TextureSpec,
        side: TextureSpec,
        top: TextureSpec | None = None,
        *,
        yaw_rad: float = 0.0,
        has_back: bool = False,
        solid: bool = True,
    ) -> None:
        """A box centred at local (x, y)."""
        centre = Pose2(*self.pose.at(x_m, y_m), self.pose.yaw_rad + yaw_rad)
        looks = (front, side, top or side)
        self.builder.box(centre, size_m, z0_m, self.room, self.name, *looks, has_back=has_back, solid=solid)

    def block(self, height_m: float, front: Look, side: Look, top: Look | None = None) -> TextureSpec:
        """A box over the whole footprint; returns the texture of its sides."""
        w, d = self.width_m, self.depth_m
        before, beside = self.pick.new(front[0], w, height_m, front[1]), self.pick.new(side[0], d, height_m, side[1])
        above = None if top is None else self.pick.new(top[0], w, d, top[1])
        self.box(0, d / 2, (w, d, height_m), 0.0, before, beside, above)
        return beside


def _clutter_on(site: Site, z_m: float, count: int) -> None:
    """Small printed boxes on top of a piece."""
    for _ in range(count):
        w, d, h = site.rng.uniform(0.06, 0.2), site.rng.uniform(0.05, 0.14), site.rng.uniform(0.08, 0.3)
        x = site.rng.uniform(-site.width_m / 2 + w, site.width_m / 2 - w) if site.width_m > 2 * w else 0.0
        front, side = site.pick.new("box_print", w, h, 700), site.pick.new("box_print", d, h, 500)
        yaw = float(site.rng.uniform(-0.5, 0.5))
        site.box(x, site.depth_m * 0.5, (w, d, h), z_m, front, side, side, has_back=True, solid=False, yaw_rad=yaw)


def build_bookshelf(site: Site) -> None:
    site.block(float(site.rng.uniform(1.1, 2.0)), ("books", 600), ("wood", 300))


def build_sideboard(site: Site) -> None:
    height = float(site.rng.uniform(0.6, 0.9))
    site.block(height, ("drawers", 450), ("wood", 350), ("wood", 300))
    _clutter_on(site, height, int(site.rng.integers(2, 5)))


def build_wardrobe(site: Site) -> None:
    site.block(2.0, ("drawers", 400), ("wood", 300))


def build_sofa(site: Site) -> None:
    w, d = site.width_m, site.depth_m
    front, side = site.pick.new("fabric", w, 0.45, 400), site.pick.new("fabric", d, 0.45, 400)
    site.box(0, d / 2, (w, d, 0.42), 0.0, front, side, site.pick.new("fabric", w, d, 300))
    back, back_side = site.pick.new("fabric", w, 0.4, 400), site.pick.new("fabric", 0.2, 0.4, 400)
    site.box(0, 0.1, (w, 0.2, 0.4), 0.42, back, back_side)
    for x in (-w / 2 + 0.35, w / 2 - 0.35):
        cushion = site.pick.new("fabric", 0.4, 0.35, 500)
        site.box(x, 0.3, (0.4, 0.12, 0.33), 0.42, cushion, cushion, solid=False)


def build_bed(site: Site) -> None:
    w, d = site.width_m, site.depth_m
    cloth = site.pick.new("fabric", max(w, d), 0.5, 400)
    site.box(0, d / 2, (w, d, 0.48), 0.0, cloth, cloth, site.pick.new("fabric", w, d, 250))
    head = site.pick.new("wood", w, 0.9, 350)
    site.box(0, 0.03, (w, 0.06, 0.9), 0.0, head, head)


def build_desk(site: Site) -> None:
    w, d = site.width_m, site.depth_m
    top, edge = site.pick.new("wood", w, d, 300), site.pick.new("wood", max(w, d), 0.04, 300)
    site.box(0, d / 2, (w, d, 0.04), 0.7, edge, edge, top)
    drawers, side = site.pick.new("drawers", 0.4, 0.7, 500), site.pick.new("wood", d, 0.7, 350)
    site.box(-w / 2 + 0.2, d / 2, (0.4, d - 0.04, 0.7), 0.0, drawers, side)
    site.box(w / 2 - 0.03, d / 2, (0.05, d - 0.04, 0.7), 0.0, side, side)
    poster = site.pick.new("poster", w - 0.5, 0.45, 500)
    site.box(0.17, 0.02, (w - 0.5, 0.03, 0.45), 0.1, poster, edge)
    screen = site.pick.new("screen", 0.55, 0.35, 500)
    site.box(0.1, 0.15, (0.55, 0.05, 0.35), 0.82, screen, edge, solid=False)


def build_counter(site: Site) -> None:
    side = site.block(0.88, ("drawers", 450), ("wood", 350), ("wood", 300))
    _clutter_on(site, 0.88, int(site.rng.integers(2, 6)))
    site.box(0, 0.16, (site.width_m, 0.32, 0.6), 1.5, site.pick.new("drawers", site.width_m, 0.6, 400), side)


def build_fridge(site: Site) -> None:
    site.block(float(site.rng.uniform(1.3, 1.9)), ("appliance", 450), ("appliance", 300))


def build_washer(site: Site) -> None:
    site.block(0.85, ("appliance", 500), ("appliance", 300))
    _clutter_on(site, 0.85, 3)


def build_television(site: Site) -> None:
    site.block(0.45, ("drawers", 500), ("wood", 350))
    w = 0.8 * site.width_m
    screen, edge = site.pick.new("screen", w, 0.6, 450), site.pick.new("wood", 0.1, 0.6, 300)
    site.box(0, 0.15, (w, 0.06, 0.6), 0.5, screen, edge, solid=False)


def build_plant(site: Site) -> None:
    pot, leaves = site.pick.new("box_print", 0.3, 0.3, 500), site.pick.new("leaves", 0.5, 0.9, 500)
    site.box(0, 0.2, (0.28, 0.28, 0.3), 0.0, pot, pot, has_back=True)
    site.box(0, 0.2, (0.4, 0.4, float(site.rng.uniform(0.5, 1.0))), 0.3, leaves, leaves, leaves, has_back=True)


def build_boxes(site: Site) -> None:
    """A pile of cardboard and toy boxes."""
    z = 0.0
    for _ in range(int(site.rng.integers(1, 4))):
        w, d, h = site.rng.uniform(0.25, 0.42), site.rng.uniform(0.2, 0.33), site.rng.uniform(0.14, 0.34)
        front, side = site.pick.new("box_print", w, h, 600), site.pick.new("box_print", d, h, 600)
        top = site.pick.new("box_print", w, d, 400)
        yaw = float(site.rng.uniform(-0.35, 0.35))
        site.box(0, 0.22, (w, d, h), z, front, side, top, has_back=True, yaw_rad=yaw)
        z += float(h)


def build_person(site: Site) -> None:
    """Something like a standing person: a dressed mannequin, coats on a stand."""
    clothes = site.pick.new("clothes", 0.46, 0.6, 500)
    trousers = site.pick.new("fabric", 0.36, 0.8, 500)
    skin = site.pick.new("skin", 0.2, 0.25, 500)
    shoes = site.pick.new("box_print", 0.28, 0.1, 500)
    yaw = float(site.rng.uniform(-0.6, 0.6))
    sizes = ((0.34, 0.3, 0.09), (0.32, 0.2, 0.75), (0.46, 0.24, 0.6), (0.18, 0.2, 0.25))
    for size, z, look in zip(sizes, (0.0, 0.09, 0.84, 1.46), (shoes, trousers, clothes, skin), strict=True):
        site.box(0, 0.22, size, z, look, look, has_back=True, yaw_rad=yaw)


def build_chair(site: Site) -> None:
    """A chair of a series: every one in the flat looks alike."""
    wood = TexturePicker.series("wood", 7, 0.45, 0.5, 400)
    cloth = TexturePicker.series("fabric", 7, 0.45, 0.5, 500)
    yaw = float(site.rng.uniform(-0.9, 0.9))
    site.box(0, 0.3, (0.42, 0.42, 0.08), 0.4, wood, wood, cloth, has_back=True, yaw_rad=yaw, solid=False)
    site.box(0, 0.3, (0.36, 0.36, 0.4), 0.0, cloth, cloth, cloth, has_back=True, yaw_rad=yaw)
    centre = Pose2(*site.pose.at(0, 0.3), site.pose.yaw_rad + yaw)
    back = Pose2(*centre.at(0, -0.19), centre.yaw_rad)
    site.builder.box(back, (0.42, 0.04, 0.45), 0.48, site.room, site.name, cloth, wood, wood, solid=False)


def build_basket(site: Site) -> None:
    cloth = site.pick.new("fabric", 0.4, 0.5, 500)
    site.box(0, 0.22, (0.4, 0.34, float(site.rng.uniform(0.35, 0.6))), 0.0, cloth, cloth, has_back=True)


PIECES: dict[str, Piece] = {
    piece.name: piece
    for piece in (
        Piece("bookshelf", (0.7, 1.2), 0.3, build_bookshelf),
        Piece("sideboard", (0.8, 1.3), 0.4, build_sideboard),
        Piece("wardrobe", (0.9, 1.4), 0.5, build_wardrobe),
        Piece("sofa", (1.4, 1.8), 0.75, build_sofa),
        Piece("bed", (0.95, 1.3), 1.7, build_bed),
        Piece("desk", (1.0, 1.3), 0.6, build_desk),
        Piece("counter", (1.1, 1.8), 0.55, build_counter),
        Piece("fridge", (0.58, 0.62), 0.6, build_fridge),
        Piece("washer", (0.6, 0.6), 0.6, build_washer),
        Piece("television", (1.0, 1.4), 0.38, build_television),
        Piece("plant", (0.42, 0.45), 0.42, build_plant),
        Piece("boxes", (0.45, 0.5), 0.45, build_boxes),
        Piece("person", (0.5, 0.55), 0.45, build_person),
        Piece("chair", (0.55, 0.6), 0.6, build_chair),
        Piece("basket", (0.42, 0.45), 0.42, build_basket),
    )
}
