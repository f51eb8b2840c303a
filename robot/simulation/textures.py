"""Painters of procedural textures: rich in corners at all scales, each picture and book spine distinct by its seed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

ImageArray = npt.NDArray[np.uint8]
Colour = tuple[int, int, int]  # BGR
Painter = Callable[[np.random.Generator, int, int, float], ImageArray]
# A painter gets a generator, width and height in texels and texels per metre, and returns (height, width, 3) BGR.


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
        """Width and height in texels."""
        return max(4, round(self.width_m * self.texels_per_m)), max(4, round(self.height_m * self.texels_per_m))


def paint(spec: TextureSpec) -> ImageArray:
    """Pixels (H, W, 3) BGR of a texture."""
    width, height = spec.size_px
    rng = np.random.default_rng([spec.seed, sum(map(ord, spec.kind))])
    image = PAINTERS[spec.kind](rng, width, height, spec.texels_per_m)
    return np.ascontiguousarray(image)


# --- building blocks ---------------------------------------------------------------------------------------------


def random_colour(rng: np.random.Generator, low: int = 30, high: int = 230) -> Colour:
    b, g, r = rng.integers(low, high, 3)
    return int(b), int(g), int(r)


def muted_colour(rng: np.random.Generator, value_low: int = 90, value_high: int = 200) -> Colour:
    """A colour as furniture and fabrics have it: moderate saturation."""
    hsv = [[[rng.integers(0, 180), rng.integers(20, 105), rng.integers(value_low, value_high)]]]
    b, g, r = cv2.cvtColor(np.array(hsv, dtype=np.uint8), cv2.COLOR_HSV2BGR)[0, 0]
    return int(b), int(g), int(r)


def scaled(colour: Colour, factor: float) -> Colour:
    """A colour made darker or brighter."""
    b, g, r = (int(min(255, max(0, c * factor))) for c in colour)
    return b, g, r


def fill(width: int, height: int, colour: Colour) -> ImageArray:
    return np.full((height, width, 3), colour, dtype=np.uint8)


def noise_field(rng: np.random.Generator, width: int, height: int, cell_px: float, aspect: float = 1.0) -> ImageArray:
    """Smooth random field (H, W) uint8 with features of about cell_px, stretched along u by aspect."""
    small = rng.integers(0, 256, (max(2, round(height / cell_px) + 2), max(2, round(width / cell_px / aspect) + 2)))
    return np.asarray(cv2.resize(small.astype(np.uint8), (width, height), interpolation=cv2.INTER_CUBIC))


def speckle(
    image: ImageArray, rng: np.random.Generator, cells_px: tuple[float, ...], strength: float, aspect: float = 1.0
) -> ImageArray:
    """Multiply an image by multi-scale grain: each octave has the given share of the brightness."""
    height, width = image.shape[:2]
    total = np.full((height, width), 128.0, dtype=np.float32)
    for cell in cells_px:
        field = noise_field(rng, width, height, max(1.0, cell), aspect).astype(np.float32) - 128.0
        total += strength * field
    total = np.clip(total / 128.0, 0.3, 1.7)
    return np.asarray(cv2.multiply(image, cv2.merge([total] * 3), dtype=cv2.CV_8U))


def draw_letters(image: ImageArray, rng: np.random.Generator, box: tuple[int, int, int, int], colour: Colour) -> None:
    """Random words inside a box (x, y, width, height)."""
    x, y, width, height = box
    if width < 6 or height < 5:
        return
    letters = "".join(chr(int(c)) for c in rng.integers(65, 91, int(rng.integers(3, 9))))
    scale = min(height / 24.0, width / (20.0 * len(letters)))
    if scale < 0.12:
        return
    font = int(rng.choice([cv2.FONT_HERSHEY_SIMPLEX, cv2.FONT_HERSHEY_TRIPLEX, cv2.FONT_HERSHEY_COMPLEX]))
    thickness = max(1, round(2.2 * scale))
    cv2.putText(image, letters, (x, y + height - 1), font, scale, colour, thickness, cv2.LINE_AA)


def draw_shapes(image: ImageArray, rng: np.random.Generator, count: int, size_px: tuple[float, float]) -> None:
    """Scatter polygons, discs, rings and strokes."""
    height, width = image.shape[:2]
    for _ in range(count):
        centre = rng.uniform([0, 0], [width, height])
        radius = float(np.exp(rng.uniform(np.log(size_px[0]), np.log(size_px[1]))))
        colour = random_colour(rng, 10, 250)
        kind = rng.integers(0, 5)
        if kind <= 1:
            corners = int(rng.integers(3, 7))
            angles = np.sort(rng.uniform(0, 2 * np.pi, corners))
            reach = radius * rng.uniform(0.5, 1.0, corners)
            points = centre + np.stack([np.cos(angles), np.sin(angles)], axis=1) * reach[:, None]
            cv2.fillPoly(image, [np.round(points).astype(np.int32)], colour, cv2.LINE_AA)
        elif kind == 2:
            cv2.circle(image, (int(centre[0]), int(centre[1])), max(1, int(radius * 0.7)), colour, -1, cv2.LINE_AA)
        elif kind == 3:
            line = max(1, int(radius * 0.2))
            cv2.circle(image, (int(centre[0]), int(centre[1])), max(1, int(radius * 0.7)), colour, line, cv2.LINE_AA)
        else:
            end = centre + rng.normal(0, radius, 2)
            start_px, end_px = (int(centre[0]), int(centre[1])), (int(end[0]), int(end[1]))
            cv2.line(image, start_px, end_px, colour, max(1, int(radius * 0.15)), cv2.LINE_AA)


def scatter_marks(
    image: ImageArray, rng: np.random.Generator, texels_per_m: float, per_m2: float, size_mm: tuple[float, float]
) -> None:
    """Small sharp marks, darker or lighter than what they lie on: specks, chips, strokes, prints, grain."""
    height, width = image.shape[:2]
    count = int(per_m2 * width * height / texels_per_m**2)
    xs, ys = rng.uniform(0, width, count).astype(int), rng.uniform(0, height, count).astype(int)
    sizes = np.exp(rng.uniform(np.log(size_mm[0]), np.log(size_mm[1]), count)) * 1e-3 * texels_per_m / 2
    tones = np.where(rng.random(count) < 0.6, rng.uniform(0.35, 0.75, count), rng.uniform(1.25, 1.7, count))
    tints = rng.uniform(0.85, 1.15, (count, 3))
    colours = np.clip(image[ys, xs] * tones[:, None] * tints, 0, 255).astype(int).tolist()
    angles, kinds = rng.uniform(0, np.pi, count), rng.integers(0, 3, count)
    for x, y, size, colour, angle, kind in zip(xs, ys, sizes, colours, angles, kinds, strict=True):
        r = max(1, round(float(size)))
        if kind == 0:
            cv2.ellipse(image, (int(x), int(y)), (r, max(1, r // 2)), float(np.degrees(angle)), 0, 360, colour, -1)
        elif kind == 1:
            dx, dy = round(1.6 * r * float(np.cos(angle))), round(1.6 * r * float(np.sin(angle)))
            cv2.line(image, (int(x) - dx, int(y) - dy), (int(x) + dx, int(y) + dy), colour, max(1, r // 2))
        else:
            cv2.rectangle(image, (int(x) - r, int(y) - max(1, r // 2)), (int(x) + r, int(y) + r), colour, -1)


def draw_grain(image: ImageArray, rng: np.random.Generator, texels_per_m: float, per_m2: float) -> None:
    """Thin dark and light lines along u, as veneer and planks have them."""
    height, width = image.shape[:2]
    for _ in range(int(per_m2 * width * height / texels_per_m**2)):
        x, y = int(rng.uniform(0, width)), int(rng.uniform(0, height))
        length = int(rng.uniform(0.01, 0.12) * texels_per_m)
        tone = float(rng.uniform(0.45, 0.75) if rng.random() < 0.65 else rng.uniform(1.15, 1.4))
        b, g, r = (int(c) for c in image[y, x])
        end = (x + length, y + int(rng.normal(0, 0.03) * length))
        cv2.line(image, (x, y), end, scaled((b, g, r), tone), max(1, int(rng.uniform(0.0008, 0.003) * texels_per_m)))


def draw_paragraph(image: ImageArray, rng: np.random.Generator, texels_per_m: float) -> None:
    """A block of small print."""
    height, width = image.shape[:2]
    line = int(rng.uniform(0.012, 0.03) * texels_per_m)
    w, rows = int(rng.uniform(0.3, 0.8) * width), int(rng.integers(2, 6))
    x, y = int(rng.uniform(0, max(1, width - w))), int(rng.uniform(0, max(1, height - rows * line)))
    colour = random_colour(rng, 0, 255)
    for k in range(rows):
        part = int(w * rng.uniform(0.15, 0.3))
        for column in range(0, w - part, part + line):
            draw_letters(image, rng, (x + column, y + k * line, part, int(0.75 * line)), colour)


def frame_edge(image: ImageArray, colour: Colour, width_px: int) -> None:
    height, width = image.shape[:2]
    cv2.rectangle(image, (0, 0), (width - 1, height - 1), colour, max(1, width_px) * 2)


# --- walls, floors ------------------------------------------------------------------------------------------------


def paint_plain_wall(rng: np.random.Generator, width: int, height: int, texels_per_m: float) -> ImageArray:
    """Nearly featureless: white paint with the faintest roller structure."""
    tone = int(rng.integers(196, 216))
    image = fill(width, height, (tone - 6, tone - 2, tone))
    return speckle(image, rng, (0.6 * texels_per_m, 0.15 * texels_per_m), 0.008)


def paint_wallpaper(rng: np.random.Generator, width: int, height: int, texels_per_m: float) -> ImageArray:
    """Scattered motifs above, a skirting board below; the scatter never repeats."""
    base = muted_colour(rng, 170, 225)
    image = speckle(
        fill(width, height, base), rng, (0.5 * texels_per_m, 0.08 * texels_per_m, 0.02 * texels_per_m), 0.05
    )
    style = rng.integers(0, 4)
    ink = scaled(base, float(rng.uniform(0.35, 0.7)))
    if style == 0:  # uneven stripes
        x = 0.0
        while x < width:
            stripe = rng.uniform(0.02, 0.12) * texels_per_m
            if rng.random() < 0.5:
                cv2.rectangle(image, (int(x), 0), (int(x + stripe), height), muted_colour(rng, 140, 225), -1)
            x += stripe
    count = int(width * height / (0.06 * texels_per_m) ** 2 * rng.uniform(0.5, 0.9))
    for _ in range(count):
        x, y = rng.uniform(0, width), rng.uniform(0, height)
        size = texels_per_m * rng.uniform(0.006, 0.028)
        colour = ink if rng.random() < 0.6 else muted_colour(rng, 90, 200)
        if style in (0, 1):  # leaves
            axes = (max(1, int(size)), max(1, int(size * 0.4)))
            cv2.ellipse(image, (int(x), int(y)), axes, float(rng.uniform(0, 360)), 0, 360, colour, -1, cv2.LINE_AA)
        elif style == 2:  # crosses and squares
            r = max(1, int(size * 0.7))
            cv2.rectangle(image, (int(x) - r, int(y) - r), (int(x) + r, int(y) + r), colour, -1)
        else:  # twigs
            for _ in range(3):
                end = (int(x + rng.normal(0, size * 1.6)), int(y + rng.normal(0, size * 1.6)))
                cv2.line(image, (int(x), int(y)), end, colour, max(1, int(size * 0.25)), cv2.LINE_AA)
    scatter_marks(image, rng, texels_per_m, 260, (4, 14))
    image = speckle(image, rng, (2.0, 0.03 * texels_per_m), 0.05)
    return add_skirting(image, rng, texels_per_m)


def paint_plaster_wall(rng: np.random.Generator, width: int, height: int, texels_per_m: float) -> ImageArray:
    """Painted wall with stains, scratches, sockets and marks."""
    base = muted_colour(rng, 175, 225)
    image = speckle(
        fill(width, height, base), rng, (0.9 * texels_per_m, 0.2 * texels_per_m, 0.04 * texels_per_m, 3.0), 0.07
    )
    scatter_marks(image, rng, texels_per_m, 420, (4, 16))
    for _ in range(int(width * height / texels_per_m**2 * 60)):
        x, y = int(rng.uniform(0, width)), int(rng.uniform(0.2 * height, height))
        dark = tuple(int(c * rng.uniform(0.55, 0.9)) for c in base)
        if rng.random() < 0.5:
            size = max(1, int(texels_per_m * rng.uniform(0.003, 0.014)))
            cv2.ellipse(image, (x, y), (size, max(1, size // 2)), float(rng.uniform(0, 180)), 0, 360, dark, -1)
        else:
            end = (x + int(rng.normal(0, 0.04 * texels_per_m)), y + int(rng.normal(0, 0.03 * texels_per_m)))
            cv2.line(image, (x, y), end, dark, 1, cv2.LINE_AA)
    for _ in range(max(1, int(width / texels_per_m * 0.8))):  # sockets
        size = int(0.08 * texels_per_m)
        x, y = int(rng.uniform(0, max(1, width - size))), height - int(0.34 * texels_per_m)
        cv2.rectangle(image, (x, y), (x + size, y + size), (235, 238, 240), -1)
        cv2.rectangle(image, (x, y), (x + size, y + size), (120, 120, 120), 1)
        cv2.circle(image, (x + size // 2, y + size // 2), size // 3, (170, 172, 175), -1, cv2.LINE_AA)
        for dx in (-1, 1):
            cv2.circle(image, (x + size // 2 + dx * size // 7, y + size // 2), max(1, size // 16), (40, 40, 40), -1)
    return add_skirting(image, rng, texels_per_m)


def paint_brick_wall(rng: np.random.Generator, width: int, height: int, texels_per_m: float) -> ImageArray:
    """Bricks of uneven tone and wear."""
    image = fill(width, height, (150, 155, 160))
    brick_h, brick_w = 0.075 * texels_per_m, 0.24 * texels_per_m
    hue = rng.integers(0, 3)
    for row in range(int(height / brick_h) + 1):
        x = -rng.uniform(0, brick_w)
        while x < width:
            length = brick_w * rng.uniform(0.8, 1.15)
            tone = float(rng.uniform(0.6, 1.15))
            base = [(70, 85, 150), (120, 140, 160), (165, 170, 175)][hue]
            colour = tuple(int(np.clip(c * tone, 0, 255)) for c in base)
            top_left = (int(x + 1), int(row * brick_h + 1))
            cv2.rectangle(image, top_left, (int(x + length - 3), int((row + 1) * brick_h - 3)), colour, -1)
            x += length
    scatter_marks(image, rng, texels_per_m, 420, (4, 14))
    return add_skirting(speckle(image, rng, (2.0, 6.0, 0.05 * texels_per_m), 0.10), rng, texels_per_m)


def paint_tiled_wall(rng: np.random.Generator, width: int, height: int, texels_per_m: float) -> ImageArray:
    """Kitchen tiles of varying tone, some with a printed motif."""
    image = fill(width, height, (175, 178, 180))
    tile = 0.15 * texels_per_m
    base = muted_colour(rng, 185, 235)
    accent = muted_colour(rng, 80, 170)
    for j in range(int(height / tile) + 1):
        for i in range(int(width / tile) + 1):
            tone = float(rng.uniform(0.86, 1.08))
            colour = tuple(int(np.clip(c * tone, 0, 255)) for c in (accent if rng.random() < 0.12 else base))
            x, y = int(i * tile), int(j * tile)
            cv2.rectangle(image, (x + 1, y + 1), (int(x + tile - 2), int(y + tile - 2)), colour, -1)
            if rng.random() < 0.45:
                patch = image[y + 3 : int(y + tile - 3), x + 3 : int(x + tile - 3)]
                if patch.size:
                    draw_shapes(patch, rng, int(rng.integers(4, 9)), (0.006 * texels_per_m, 0.03 * texels_per_m))
    scatter_marks(image, rng, texels_per_m, 300, (3, 10))
    return add_skirting(speckle(image, rng, (2.0, 0.1 * texels_per_m), 0.04), rng, texels_per_m)


def add_skirting(image: ImageArray, rng: np.random.Generator, texels_per_m: float) -> ImageArray:
    """A skirting board along the foot of a wall, and the shade of floor and ceiling corners."""
    height, width = image.shape[:2]
    board = round(0.08 * texels_per_m)
    light = (225, 228, 230) if rng.random() < 0.5 else (70, 95, 125)
    strip = speckle(fill(width, board, light), rng, (2.0, 0.02 * texels_per_m), 0.08, aspect=12.0)
    image[height - board :] = strip
    image[height - board : height - board + 2] = (90, 92, 95)
    return image


def paint_planks(rng: np.random.Generator, width: int, height: int, texels_per_m: float) -> ImageArray:
    """Parquet: planks of different tone with grain and knots."""
    image = fill(width, height, (60, 80, 100))
    plank_h = rng.uniform(0.09, 0.16) * texels_per_m
    base = np.array([[70, 115, 165], [95, 140, 185], [60, 85, 120], [120, 150, 175]][rng.integers(0, 4)], dtype=float)
    for row in range(int(height / plank_h) + 1):
        x = -rng.uniform(0, 0.8) * texels_per_m
        while x < width:
            length = rng.uniform(0.4, 1.2) * texels_per_m
            colour = tuple(int(c) for c in np.clip(base * rng.uniform(0.72, 1.2), 0, 255))
            cv2.rectangle(image, (int(x), int(row * plank_h)), (int(x + length), int((row + 1) * plank_h)), colour, -1)
            cv2.line(image, (int(x), int(row * plank_h)), (int(x), int((row + 1) * plank_h)), (30, 40, 50), 1)
            x += length
        cv2.line(image, (0, int(row * plank_h)), (width, int(row * plank_h)), (30, 40, 50), 1)
    image = speckle(image, rng, (1.5, 0.012 * texels_per_m, 0.05 * texels_per_m), 0.10, aspect=9.0)
    draw_grain(image, rng, texels_per_m, 160)
    scatter_marks(image, rng, texels_per_m, 160, (5, 18))
    for _ in range(int(width * height / texels_per_m**2 * 14)):  # knots
        x, y = int(rng.uniform(0, width)), int(rng.uniform(0, height))
        size = max(1, int(texels_per_m * rng.uniform(0.004, 0.016)))
        dark = tuple(int(c) for c in base * rng.uniform(0.25, 0.6))
        cv2.ellipse(image, (x, y), (int(size * 1.7), size), 0, 0, 360, dark, -1, cv2.LINE_AA)
    return image


def paint_floor_tiles(rng: np.random.Generator, width: int, height: int, texels_per_m: float) -> ImageArray:
    """Stone tiles with veins."""
    image = fill(width, height, (90, 92, 95))
    tile = rng.uniform(0.28, 0.42) * texels_per_m
    base = np.array(muted_colour(rng, 130, 200), dtype=float)
    for j in range(int(height / tile) + 1):
        for i in range(int(width / tile) + 1):
            colour = tuple(int(c) for c in np.clip(base * rng.uniform(0.8, 1.15), 0, 255))
            x, y = int(i * tile), int(j * tile)
            cv2.rectangle(image, (x + 1, y + 1), (int(x + tile - 2), int(y + tile - 2)), colour, -1)
            for _ in range(int(rng.integers(2, 7))):
                points = np.cumsum(rng.normal(0, tile * 0.12, (6, 2)), axis=0) + rng.uniform(0, tile, 2) + [x, y]
                tone = tuple(int(c) for c in np.clip(base * rng.uniform(0.5, 1.3), 0, 255))
                cv2.polylines(image, [points.astype(np.int32)], False, tone, 1, cv2.LINE_AA)
    scatter_marks(image, rng, texels_per_m, 450, (5, 20))  # terrazzo
    return speckle(image, rng, (2.0, 0.02 * texels_per_m, 0.15 * texels_per_m), 0.08)


def paint_rug(rng: np.random.Generator, width: int, height: int, texels_per_m: float) -> ImageArray:
    """A woven pattern that repeats, inside a border that repeats too."""
    ground = muted_colour(rng, 60, 160)
    image = fill(width, height, ground)
    cell = max(6, int(rng.uniform(0.14, 0.3) * texels_per_m))
    motif = fill(cell, cell, ground)
    draw_shapes(motif, rng, 7, (0.1 * cell, 0.45 * cell))
    motif = np.maximum(motif, motif[:, ::-1]) if rng.random() < 0.5 else motif
    tiled = np.tile(motif, (height // cell + 1, width // cell + 1, 1))[:height, :width]
    image[:] = tiled
    border = max(3, int(0.09 * texels_per_m))
    for k, colour in enumerate((muted_colour(rng, 40, 120), muted_colour(rng, 150, 230), muted_colour(rng, 40, 120))):
        inset = k * border // 3
        cv2.rectangle(image, (inset, inset), (width - 1 - inset, height - 1 - inset), colour, max(1, border // 3))
    return speckle(image, rng, (1.2, 0.03 * texels_per_m), 0.12)


def paint_ceiling(rng: np.random.Generator, width: int, height: int, texels_per_m: float) -> ImageArray:
    image = fill(width, height, (205, 210, 212))
    return speckle(image, rng, (0.7 * texels_per_m, 0.1 * texels_per_m), 0.04)


# --- furniture ----------------------------------------------------------------------------------------------------


def paint_wood(rng: np.random.Generator, width: int, height: int, texels_per_m: float) -> ImageArray:
    """Veneer: grain along u."""
    base = [(70, 115, 165), (45, 65, 95), (120, 160, 195), (200, 205, 208), (60, 60, 62)][rng.integers(0, 5)]
    image = speckle(fill(width, height, base), rng, (1.5, 0.012 * texels_per_m, 0.06 * texels_per_m), 0.10, aspect=10.0)
    draw_grain(image, rng, texels_per_m, 420)
    scatter_marks(image, rng, texels_per_m, 180, (3, 10))
    for _ in range(int(width * height / texels_per_m**2 * 25)):
        x, y = int(rng.uniform(0, width)), int(rng.uniform(0, height))
        size = max(1, int(texels_per_m * rng.uniform(0.003, 0.012)))
        dark = tuple(int(c * rng.uniform(0.3, 0.7)) for c in base)
        cv2.ellipse(image, (x, y), (2 * size, size), 0, 0, 360, dark, -1, cv2.LINE_AA)
    frame_edge(image, scaled(base, 0.7), int(0.006 * texels_per_m))
    return image


def paint_drawers(rng: np.random.Generator, width: int, height: int, texels_per_m: float) -> ImageArray:
    """Front of a cabinet: doors and drawers with handles, now and then a sticker."""
    image = paint_wood(rng, width, height, texels_per_m)
    columns = max(1, round(width / texels_per_m / rng.uniform(0.35, 0.6)))
    for c in range(columns):
        x0, x1 = c * width // columns, (c + 1) * width // columns
        rows = max(1, round(height / texels_per_m / rng.uniform(0.2, 0.7)))
        for r in range(rows):
            y0, y1 = r * height // rows, (r + 1) * height // rows
            cv2.rectangle(image, (x0 + 2, y0 + 2), (x1 - 3, y1 - 3), (35, 40, 45), max(1, int(0.004 * texels_per_m)))
            handle = (int((x0 + x1) / 2), int(y0 + 0.25 * (y1 - y0)))
            if rng.random() < 0.5:
                cv2.circle(image, handle, max(2, int(0.015 * texels_per_m)), (190, 195, 200), -1, cv2.LINE_AA)
            else:
                half = int(0.06 * texels_per_m)
                cv2.line(image, (handle[0] - half, handle[1]), (handle[0] + half, handle[1]), (200, 205, 205), 3)
            if rng.random() < 0.55:
                size = int(rng.uniform(0.05, 0.16) * texels_per_m)
                sx, sy = int(rng.uniform(x0, max(x0 + 1, x1 - size))), int(rng.uniform(y0, max(y0 + 1, y1 - size)))
                sticker = image[sy : sy + size, sx : sx + size]
                if min(sticker.shape[:2]) > 4:
                    sticker[:] = random_colour(rng, 120, 250)
                    draw_shapes(sticker, rng, 5, (0.1 * size, 0.4 * size))
    return image


def paint_books(rng: np.random.Generator, width: int, height: int, texels_per_m: float) -> ImageArray:
    """Open shelves full of books, boxes and knick-knacks: every spine differs."""
    wood = paint_wood(rng, width, height, texels_per_m)
    image = (wood * 0.35).astype(np.uint8)
    shelf_h = rng.uniform(0.28, 0.38) * texels_per_m
    board = max(2, int(0.02 * texels_per_m))
    rows = max(1, round(height / shelf_h))
    shelf_h = height / rows
    for r in range(rows):
        floor_y = int((r + 1) * shelf_h) - board
        x = float(board)
        while x < width - board:
            if rng.random() < 0.07:
                x += rng.uniform(0.03, 0.12) * texels_per_m
                continue
            book_w = rng.uniform(0.018, 0.055) * texels_per_m
            book_h = rng.uniform(0.5, 0.92) * (shelf_h - board)
            if rng.random() < 0.08:  # a box or a toy
                book_w, book_h = rng.uniform(0.09, 0.2) * texels_per_m, rng.uniform(0.3, 0.8) * (shelf_h - board)
            x1, y0 = int(min(x + book_w, width - board)), int(floor_y - book_h)
            spine = image[y0:floor_y, int(x) : x1]
            if spine.shape[0] > 2 and spine.shape[1] > 1:
                paint_spine(spine, rng)
            x = x1 + 1
        cv2.rectangle(image, (0, floor_y), (width, floor_y + board), tuple(int(c) for c in wood[0, 0]), -1)
    frame_edge(image, (int(wood[0, 0, 0]), int(wood[0, 0, 1]), int(wood[0, 0, 2])), board // 2)
    return speckle(image, rng, (1.5,), 0.05)


def paint_spine(spine: ImageArray, rng: np.random.Generator) -> None:
    """One book's back: colour, bands and a title."""
    height, width = spine.shape[:2]
    spine[:] = random_colour(rng, 15, 245)
    for _ in range(int(rng.integers(1, 5))):
        y, band = int(rng.uniform(0, height)), max(1, int(rng.uniform(0.01, 0.12) * height))
        spine[y : y + band] = random_colour(rng, 10, 250)
    upright = np.ascontiguousarray(np.rot90(spine))
    box = (int(0.15 * height), int(0.25 * width), int(0.6 * height), max(4, int(0.5 * width)))
    draw_letters(upright, rng, box, random_colour(rng, 0, 255))
    spine[:] = np.rot90(upright, -1)
    spine[:, :1] = (spine[:, :1] * 0.5).astype(np.uint8)


def paint_fabric(rng: np.random.Generator, width: int, height: int, texels_per_m: float) -> ImageArray:
    """Sofa, bed or curtain cloth: print, weave and creases."""
    base = muted_colour(rng, 70, 210)
    image = fill(width, height, base)
    style = rng.integers(0, 4)
    if style == 0:  # check
        for axis in (0, 1):
            position = 0.0
            while position < (width, height)[axis]:
                band = rng.uniform(0.01, 0.06) * texels_per_m
                if rng.random() < 0.55:
                    stripes = image if axis == 0 else image.transpose(1, 0, 2)
                    stripe = stripes[:, int(position) : int(position + band)]
                    stripe[:] = (0.5 * stripe + 0.5 * np.array(muted_colour(rng, 40, 230))).astype(np.uint8)
                position += band
    elif style == 1:  # big print
        count = max(4, int(width * height / (0.13 * texels_per_m) ** 2))
        draw_shapes(image, rng, count, (0.02 * texels_per_m, 0.1 * texels_per_m))
    elif style == 2:  # small flowers
        for _ in range(int(width * height / (0.05 * texels_per_m) ** 2)):
            x, y = int(rng.uniform(0, width)), int(rng.uniform(0, height))
            size = max(1, int(rng.uniform(0.004, 0.012) * texels_per_m))
            cv2.circle(image, (x, y), size, random_colour(rng, 60, 250), -1, cv2.LINE_AA)
    else:
        image = speckle(image, rng, (0.1 * texels_per_m, 0.03 * texels_per_m), 0.16)
    for _ in range(int(width / texels_per_m * 6) + 3):  # creases
        x, y = int(rng.uniform(0, width)), int(rng.uniform(0, height))
        end = (int(x + rng.normal(0, 0.08 * texels_per_m)), int(y + rng.normal(0, 0.08 * texels_per_m)))
        dark = tuple(int(c * 0.55) for c in base)
        cv2.line(image, (x, y), end, dark, max(1, int(0.003 * texels_per_m)), cv2.LINE_AA)
    scatter_marks(image, rng, texels_per_m, 650, (4, 15))
    return speckle(image, rng, (1.3, 0.012 * texels_per_m, 0.2 * texels_per_m), 0.07)


def paint_box_print(rng: np.random.Generator, width: int, height: int, texels_per_m: float) -> ImageArray:
    """Printed cardboard: cereal boxes, toy boxes, moving boxes."""
    plain = rng.random() < 0.35
    base = (105, 150, 190) if plain else random_colour(rng, 40, 235)
    image = fill(width, height, base)
    if not plain:
        draw_shapes(image, rng, int(rng.integers(8, 18)), (0.06 * min(width, height), 0.5 * min(width, height)))
    for _ in range(int(rng.integers(2, 6))):
        w, h = int(rng.uniform(0.25, 0.8) * width), int(rng.uniform(0.06, 0.2) * height)
        x, y = int(rng.uniform(0, max(1, width - w))), int(rng.uniform(0, max(1, height - h)))
        draw_letters(image, rng, (x, y, w, h), random_colour(rng, 0, 255))
    for _ in range(3):
        draw_paragraph(image, rng, texels_per_m)
    scatter_marks(image, rng, texels_per_m, 250, (3, 10))
    x, y, bar = int(0.7 * width), int(0.8 * height), max(1, width // 60)
    for k in range(9):  # a bar code
        if rng.random() < 0.6:
            cv2.rectangle(image, (x + k * bar, y), (x + (k + 1) * bar - 1, int(0.93 * height)), (20, 20, 20), -1)
    frame_edge(image, scaled(base, 0.6), 1)
    return speckle(image, rng, (1.5, 0.05 * texels_per_m), 0.05)


def paint_poster(rng: np.random.Generator, width: int, height: int, texels_per_m: float) -> ImageArray:
    """A framed picture: landscape, abstract or printed poster; no two alike."""
    style = rng.integers(0, 3)
    sky, ground = np.array(random_colour(rng, 60, 250), float), np.array(random_colour(rng, 20, 200), float)
    ramp = np.linspace(0, 1, height)[:, None, None]
    image = np.broadcast_to(sky * (1 - ramp) + ground * ramp, (height, width, 3)).astype(np.uint8).copy()
    if style == 0:  # hills, sun, houses
        for layer in range(4):
            tone = tuple(int(c) for c in np.clip(ground * rng.uniform(0.4, 1.4), 0, 255))
            xs = np.linspace(0, width, 12)
            ys = height * (0.35 + 0.15 * layer) + rng.normal(0, 0.06 * height, 12)
            outline = np.concatenate([np.stack([xs, ys], 1), [[width, height], [0, height]]]).astype(np.int32)
            cv2.fillPoly(image, [outline], tone, cv2.LINE_AA)
        draw_shapes(image, rng, 60, (0.01 * width, 0.1 * width))
    elif style == 1:
        draw_shapes(image, rng, 30, (0.05 * width, 0.3 * width))
        draw_shapes(image, rng, 70, (0.01 * width, 0.07 * width))
    else:
        draw_shapes(image, rng, 9, (0.05 * width, 0.35 * width))
        draw_shapes(image, rng, 40, (0.01 * width, 0.06 * width))
        for _ in range(3):
            draw_paragraph(image, rng, texels_per_m)
        for k in range(int(rng.integers(3, 8))):
            box = (int(0.08 * width), int((0.05 + 0.12 * k) * height), int(0.8 * width), int(0.08 * height))
            draw_letters(image, rng, box, random_colour(rng, 0, 255))
    image = speckle(image, rng, (2.0, 0.03 * texels_per_m), 0.08)
    frame_edge(image, [(30, 30, 32), (210, 215, 218), (50, 80, 115)][rng.integers(0, 3)], int(0.012 * texels_per_m))
    return image


def paint_appliance(rng: np.random.Generator, width: int, height: int, texels_per_m: float) -> ImageArray:
    """Fridge or washing machine: smooth front with magnets, notes and a dial."""
    tone = int(rng.integers(185, 225))
    image = speckle(fill(width, height, (tone, tone, tone)), rng, (0.4 * texels_per_m,), 0.03)
    cv2.rectangle(image, (3, 3), (width - 4, int(0.3 * height)), (110, 112, 115), max(1, int(0.004 * texels_per_m)))
    if width > 0.7 * height:  # a drum
        centre, radius = (width // 2, int(0.6 * height)), int(0.28 * min(width, height))
        for r, colour in ((radius, (120, 120, 122)), (int(radius * 0.85), (45, 45, 48)), (radius // 2, (75, 70, 66))):
            cv2.circle(image, centre, r, colour, -1, cv2.LINE_AA)
    for _ in range(int(rng.integers(28, 45))):
        w, h = (int(v * texels_per_m) for v in rng.uniform(0.025, 0.12, 2))
        x, y = int(rng.uniform(0, max(1, width - w))), int(rng.uniform(0, max(1, height - h)))
        note = image[y : y + h, x : x + w]
        if min(note.shape[:2]) > 4:
            note[:] = random_colour(rng, 130, 250)
            draw_shapes(note, rng, 5, (0.06 * w, 0.3 * w))
            draw_letters(note, rng, (1, 1, w - 2, h // 3), (20, 20, 20))
    scatter_marks(image, rng, texels_per_m, 60, (3, 9))
    frame_edge(image, (90, 90, 92), 2)
    return image


def paint_screen(rng: np.random.Generator, width: int, height: int, texels_per_m: float) -> ImageArray:
    """A television that shows one picture."""
    image = paint_poster(rng, width, height, texels_per_m)
    frame_edge(image, (25, 25, 25), int(0.025 * texels_per_m))
    return image


def paint_clothes(rng: np.random.Generator, width: int, height: int, texels_per_m: float) -> ImageArray:
    """Cloth with a print, as a person wears it."""
    image = paint_fabric(rng, width, height, texels_per_m)
    w, h = int(0.5 * width), int(0.15 * height)
    draw_letters(image, rng, (int(0.25 * width), int(0.35 * height), w, h), random_colour(rng, 0, 255))
    return image


def paint_skin(rng: np.random.Generator, width: int, height: int, texels_per_m: float) -> ImageArray:
    """A simple face and hair."""
    image = speckle(fill(width, height, (130, 165, 205)), rng, (0.03 * texels_per_m,), 0.06)
    image[: height // 4] = random_colour(rng, 20, 90)
    for x in (0.32, 0.68):
        cv2.circle(image, (int(x * width), int(0.48 * height)), max(1, width // 14), (40, 40, 40), -1, cv2.LINE_AA)
    cv2.ellipse(image, (width // 2, int(0.75 * height)), (width // 5, height // 16), 0, 0, 180, (70, 70, 150), 2)
    return image


def paint_leaves(rng: np.random.Generator, width: int, height: int, texels_per_m: float) -> ImageArray:
    """A dense pot plant."""
    image = fill(width, height, (25, 50, 30))
    for _ in range(int(width * height / (0.03 * texels_per_m) ** 2)):
        x, y = int(rng.uniform(0, width)), int(rng.uniform(0, height))
        size = max(2, int(rng.uniform(0.015, 0.05) * texels_per_m))
        green = (int(rng.integers(20, 90)), int(rng.integers(80, 200)), int(rng.integers(20, 120)))
        axes = (size, max(1, size // 3))
        cv2.ellipse(image, (x, y), axes, float(rng.uniform(0, 180)), 0, 360, green, -1, cv2.LINE_AA)
    return image


def paint_checker(_rng: np.random.Generator, width: int, height: int, texels_per_m: float) -> ImageArray:
    """Squares of 0.1 m with known corners: for geometry tests."""
    cell = 0.1 * texels_per_m
    i = (np.arange(width) // cell).astype(int)
    j = (np.arange(height) // cell).astype(int)
    grey = np.where((i[None, :] + j[:, None]) % 2 == 0, 40, 215).astype(np.uint8)
    return np.asarray(cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR), dtype=np.uint8)


PAINTERS: dict[str, Painter] = {
    "plain_wall": paint_plain_wall,
    "wallpaper": paint_wallpaper,
    "plaster": paint_plaster_wall,
    "brick": paint_brick_wall,
    "tiled": paint_tiled_wall,
    "planks": paint_planks,
    "floor_tiles": paint_floor_tiles,
    "rug": paint_rug,
    "ceiling": paint_ceiling,
    "wood": paint_wood,
    "drawers": paint_drawers,
    "books": paint_books,
    "fabric": paint_fabric,
    "box_print": paint_box_print,
    "poster": paint_poster,
    "appliance": paint_appliance,
    "screen": paint_screen,
    "clothes": paint_clothes,
    "skin": paint_skin,
    "leaves": paint_leaves,
    "checker": paint_checker,
}
