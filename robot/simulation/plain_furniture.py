"""Furniture of plain homes, and things on it. Each piece stands with its back at local y = 0, facing +y."""

from __future__ import annotations

from dataclasses import dataclass

from robot.simulation.furniture import Piece, Site
from robot.simulation.textures import TextureSpec
from robot.simulation.world import Obstacle

LEG_M = 0.045


def _cloth(site: Site, width_m: float, height_m: float) -> TextureSpec:
    return site.pick.new("soft_cloth", width_m, height_m, 220)


def _pattern(site: Site, width_m: float, height_m: float) -> TextureSpec:
    return site.pick.new("patterned_cloth", width_m, height_m, 250)


def _board(site: Site, width_m: float, height_m: float) -> TextureSpec:
    return site.pick.new("lacquer", width_m, height_m, 250)


def _keep_out(site: Site, x_m: float, y_m: float, width_m: float, depth_m: float, height_m: float) -> None:
    """Nobody drives in between these legs."""
    x, y = site.pose.at(x_m, y_m)
    place = (x, y, width_m / 2, depth_m / 2, site.pose.yaw_rad)
    site.builder.obstacles.append(Obstacle(*place, height_m, site.name, site.room))


def _on_legs(site: Site, y_m: float, size_m: tuple[float, float, float], top: TextureSpec, legs: TextureSpec) -> None:
    """A board (width, depth, height of its upper face) on four legs, its middle at local (0, y)."""
    w, d, h = size_m
    for x in (-w / 2 + LEG_M, w / 2 - LEG_M):
        for y in (-d / 2 + LEG_M, d / 2 - LEG_M):
            site.box(x, y_m + y, (LEG_M, LEG_M, h - 0.03), 0.0, legs, legs, has_back=True, solid=False)
    site.box(0, y_m, (w, d, 0.03), h - 0.03, legs, legs, top, has_back=True, solid=False)
    _keep_out(site, 0, y_m, w, d, h)


def build_bed(site: Site) -> None:
    """Along the wall: frame, mattress with a patterned cover, a pillow, a low headboard at one end."""
    w, d = site.width_m, site.depth_m
    frame, linen, pillow = _board(site, w, 0.28), _pattern(site, w, d), _cloth(site, 0.4, 0.6)
    side, end = _pattern(site, w, 0.2), float(site.rng.choice([-1.0, 1.0]))
    site.box(0, d / 2, (w, d, 0.28), 0.0, frame, frame)
    site.box(0, d / 2, (w - 0.06, d - 0.06, 0.2), 0.28, side, side, linen, solid=False)
    site.box(end * (w / 2 - 0.03), d / 2, (0.05, d, 0.85), 0.0, frame, frame, has_back=True)
    site.box(end * (w / 2 - 0.3), d / 2, (0.36, 0.6, 0.1), 0.48, pillow, pillow, solid=False)


@dataclass(frozen=True, slots=True)
class _Thing:
    """Something that stands on furniture."""

    kind: str  # of the texture in front
    side: str  # of the texture of the other faces
    smallest_m: tuple[float, float, float]  # width, depth, height
    largest_m: tuple[float, float, float]


_THINGS = (
    _Thing("spines", "lacquer", (0.12, 0.13, 0.18), (0.3, 0.18, 0.26)),
    _Thing("bottle", "bottle", (0.06, 0.06, 0.2), (0.09, 0.09, 0.3)),
    _Thing("bowl", "bowl", (0.16, 0.16, 0.07), (0.25, 0.2, 0.12)),
    _Thing("labelled_box", "lacquer", (0.12, 0.12, 0.1), (0.25, 0.2, 0.2)),
)


def _things_on(site: Site, y_m: float, z_m: float, most: int) -> None:
    """Books, bottles, bowls or boxes in a row on top of a piece, at least one, with gaps."""
    count = int(site.rng.integers(1, most + 1))
    for k in range(count):
        thing = _THINGS[int(site.rng.integers(0, len(_THINGS)))]
        w, d, h = (float(v) for v in site.rng.uniform(thing.smallest_m, thing.largest_m))
        room_m = site.width_m / count
        x = -site.width_m / 2 + (k + 0.5) * room_m + float(site.rng.uniform(-0.5, 0.5)) * max(0.0, room_m - w)
        front, side = site.pick.new(thing.kind, w, h, 400), site.pick.new(thing.side, max(w, d), max(d, h), 300)
        yaw = float(site.rng.uniform(-0.3, 0.3))
        site.box(x, y_m, (w, d, h), z_m, front, side, side, yaw_rad=yaw, has_back=True, solid=False)


def build_wardrobe(site: Site) -> None:
    site.block(2.1, ("fronts", 250), ("lacquer", 200))


def build_dresser(site: Site) -> None:
    height = float(site.rng.choice([0.55, 0.8]))
    site.block(height, ("fronts", 300), ("lacquer", 250), ("lacquer", 200))
    _things_on(site, site.depth_m / 2, height, 4)


def build_nightstand(site: Site) -> None:
    site.block(0.45, ("fronts", 350), ("lacquer", 300), ("lacquer", 250))
    _things_on(site, site.depth_m / 2, 0.45, 2)


def build_sofa(site: Site) -> None:
    w, d = site.width_m, site.depth_m
    front, side, seat = _cloth(site, w, 0.4), _cloth(site, d, 0.55), _cloth(site, w, d)
    site.box(0, d / 2, (w, d, 0.4), 0.0, front, side, seat)
    site.box(0, 0.1, (w, 0.2, 0.4), 0.4, front, side, seat)
    for x in (-w / 2 + 0.09, w / 2 - 0.09):
        site.box(x, d / 2, (0.18, d, 0.18), 0.4, side, side, side, solid=False)
    for x in (-0.25 * w, 0.22 * w):
        cushion, yaw = _pattern(site, 0.4, 0.4), float(site.rng.uniform(-0.2, 0.2))
        site.box(x, 0.28, (0.4, 0.12, 0.36), 0.4, cushion, cushion, cushion, yaw_rad=yaw, solid=False)


def build_low_board(site: Site) -> None:
    """A low cabinet with a television that is off."""
    site.block(0.42, ("fronts", 300), ("lacquer", 250), ("lacquer", 200))
    _things_on(site, 0.3, 0.42, 4)
    w = 0.75 * site.width_m
    glass = site.pick.new("dark_glass", w, 0.6, 200)
    site.box(0, 0.18, (w, 0.05, 0.6), 0.48, glass, glass, solid=False)


def build_open_shelf(site: Site) -> None:
    site.block(float(site.rng.choice([0.8, 1.6])), ("open_shelf", 300), ("lacquer", 250), ("lacquer", 200))


def build_table(site: Site) -> None:
    """A table on four legs with one or two chairs of the home's set before it."""
    w = site.width_m
    _on_legs(site, 0.38, (w, 0.7, 0.74), _board(site, w, 0.7), _board(site, LEG_M, 0.75))
    _things_on(site, 0.45, 0.74, 4)
    wood, seat = site.pick.series("lacquer", 3, 0.42, 0.5, 300), site.pick.series("patterned_cloth", 3, 0.42, 0.42, 250)
    count = 1 + int(w > 1.2)
    for k in range(count):
        x = (k - (count - 1) / 2) * 0.55 + float(site.rng.uniform(-0.06, 0.06))
        y, yaw = 0.8 + float(site.rng.uniform(-0.05, 0.05)), float(site.rng.uniform(-0.25, 0.25))
        site.box(x, y, (0.4, 0.4, 0.05), 0.42, seat, seat, seat, yaw_rad=yaw, has_back=True, solid=False)
        site.box(x, y, (0.05, 0.05, 0.42), 0.0, wood, wood, yaw_rad=yaw, has_back=True, solid=False)
        site.box(x, y, (0.36, 0.36, 0.03), 0.0, wood, wood, wood, yaw_rad=yaw, has_back=True, solid=False)
        site.box(x, y + 0.19, (0.4, 0.03, 0.4), 0.47, seat, seat, yaw_rad=yaw, has_back=True, solid=False)
        _keep_out(site, x, y, 0.42, 0.42, 0.9)


def build_kitchen_row(site: Site) -> None:
    """Equal cupboards with an oven among them, things on the worktop, tiles behind it, equal cupboards above."""
    w = site.width_m
    site.block(0.88, ("fronts", 300), ("lacquer", 250), ("lacquer", 200))
    x = float(site.rng.choice([-0.3, 0.3]))
    oven = site.pick.new("dark_glass", 0.5, 0.45, 250)
    site.box(x, site.depth_m, (0.5, 0.02, 0.45), 0.25, oven, oven, solid=False)
    _things_on(site, 0.35, 0.88, 6)
    tiles = site.pick.new("wall_tiles", w, 0.62, 250)
    site.box(0, 0.015, (w, 0.01, 0.62), 0.88, tiles, tiles, solid=False)
    upper, side = site.pick.new("fronts", w, 0.6, 250), _board(site, 0.32, 0.6)
    site.box(0, 0.16, (w, 0.32, 0.6), 1.5, upper, side)


def build_fridge(site: Site) -> None:
    front = site.pick.new("fronts", 0.6, 1.75, 250)
    site.box(0, 0.3, (0.6, 0.6, 1.75), 0.0, front, _board(site, 0.6, 1.75))
    notes = site.pick.new("note_board", 0.3, 0.4, 300)
    site.box(0, 0.605, (0.3, 0.004, 0.4), 0.8, notes, notes, solid=False)


def build_crate(site: Site) -> None:
    """A storage box with a label, or a toy box."""
    w, look = site.width_m, site.pick.new(str(site.rng.choice(["labelled_box", "toy_box"])), 0.5, 0.4, 300)
    yaw = float(site.rng.uniform(-0.4, 0.4))
    site.box(0, 0.25, (w, 0.34, float(site.rng.uniform(0.25, 0.4))), 0.0, look, look, look, yaw_rad=yaw, has_back=True)


def build_basket(site: Site) -> None:
    look, side = site.pick.new("wicker", 0.34, 0.45, 300), 0.34
    site.box(0, 0.2, (side, side, float(site.rng.uniform(0.3, 0.45))), 0.0, look, look, look, has_back=True)


def build_plant(site: Site) -> None:
    """A pot and a few large leaves."""
    pot, leaves = _board(site, 0.26, 0.26), site.pick.new("house_plant", 0.34, 0.5, 300)
    site.box(0, 0.2, (0.26, 0.26, 0.26), 0.0, pot, pot, pot, has_back=True)
    height = float(site.rng.uniform(0.3, 0.5))
    site.box(0, 0.2, (0.34, 0.34, height), 0.26, leaves, leaves, leaves, has_back=True, solid=False)


def build_pile(site: Site) -> None:
    """Books and boxes on the floor, one on the other, a bit askew."""
    for x in (-0.17, 0.17):
        z = 0.0
        for _ in range(int(site.rng.integers(3, 6))):
            w, d, h = (float(v) for v in site.rng.uniform([0.18, 0.16, 0.03], [0.3, 0.24, 0.09]))
            look, yaw = _board(site, w, h), float(site.rng.uniform(-0.3, 0.3))
            front = site.pick.new("labelled_box", w, h, 400)
            site.box(x, 0.2, (w, d, h), z, front, look, look, yaw_rad=yaw, has_back=True)
            z += h


def build_shoes(site: Site) -> None:
    """Three pairs, side by side."""
    for k in range(3):
        look = site.pick.new("shoe", 0.1, 0.28, 300)
        for x in (0.0, 0.12):
            at = (k - 1) * 0.28 + x
            yaw = float(site.rng.uniform(-0.1, 0.1))
            site.box(at, 0.18, (0.095, 0.27, 0.09), 0.0, look, look, look, yaw_rad=yaw, has_back=True)


PLAIN_PIECES: dict[str, Piece] = {
    piece.name: piece
    for piece in (
        Piece("bed", (1.95, 2.1), 1.05, build_bed),
        Piece("wardrobe", (1.0, 1.7), 0.58, build_wardrobe),
        Piece("dresser", (0.8, 1.2), 0.42, build_dresser),
        Piece("nightstand", (0.42, 0.48), 0.38, build_nightstand),
        Piece("sofa", (1.5, 2.1), 0.85, build_sofa),
        Piece("low board", (1.3, 1.8), 0.4, build_low_board),
        Piece("open shelf", (0.7, 1.1), 0.32, build_open_shelf),
        Piece("table", (1.0, 1.5), 1.05, build_table),
        Piece("kitchen row", (1.7, 2.4), 0.6, build_kitchen_row),
        Piece("fridge", (0.6, 0.62), 0.6, build_fridge),
        Piece("crate", (0.45, 0.5), 0.5, build_crate),
        Piece("basket", (0.4, 0.42), 0.4, build_basket),
        Piece("pile", (0.66, 0.7), 0.4, build_pile),
        Piece("plant", (0.36, 0.4), 0.4, build_plant),
        Piece("shoes", (0.85, 0.9), 0.34, build_shoes),
        Piece("hall board", (0.7, 0.9), 0.24, build_dresser),
    )
}
