"""What painters of textures draw with: colours, grain, marks, letters, shapes."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

ImageArray = npt.NDArray[np.uint8]
Colour = tuple[int, int, int]  # BGR


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
