"""What painters of textures draw with: colours, grain, marks, letters, shapes."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

ImageArray = npt.NDArray[np.uint8]
Colour = tuple[int, int, int]  # BGR


def scaled(colour: Colour, factor: float) -> Colour:
    """A colour made darker or brighter."""
    b, g, r = (int(min(255, max(0, c * factor))) for c in colour)
    return b, g, r


@dataclass(frozen=True, slots=True, eq=False)
class Canvas:
    """A picture in the making, or a part of one: all strokes change its pixels."""

    image: ImageArray  # (H, W, 3) BGR
    rng: np.random.Generator
    texels_per_m: float
    text: str = ""  # that is printed on it

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height in texels."""
        height, width = self.image.shape[:2]
        return width, height

    @property
    def area_m2(self) -> float:
        width, height = self.size_px
        return width * height / self.texels_per_m**2

    def part(self, x: int, y: int, width: int, height: int) -> Canvas:
        """A window that shares its pixels with this canvas."""
        return Canvas(self.image[y : y + height, x : x + width], self.rng, self.texels_per_m)

    def spot(self) -> tuple[int, int]:
        """A random texel (x, y)."""
        width, height = self.size_px
        return int(self.rng.uniform(0, width)), int(self.rng.uniform(0, height))

    def length_px(self, low_m: float, high_m: float) -> int:
        """A random length in texels."""
        return int(self.rng.uniform(low_m, high_m) * self.texels_per_m)

    def random_colour(self, low: int = 30, high: int = 230) -> Colour:
        b, g, r = self.rng.integers(low, high, 3)
        return int(b), int(g), int(r)

    def muted_colour(self, value_low: int = 90, value_high: int = 200) -> Colour:
        """A colour as furniture and fabrics have it: moderate saturation."""
        hsv = [[[self.rng.integers(0, 180), self.rng.integers(20, 105), self.rng.integers(value_low, value_high)]]]
        b, g, r = cv2.cvtColor(np.array(hsv, dtype=np.uint8), cv2.COLOR_HSV2BGR)[0, 0]
        return int(b), int(g), int(r)

    def fill(self, colour: Colour) -> None:
        self.image[:] = colour

    def speckle(self, cells_px: tuple[float, ...], strength: float, aspect: float = 1.0) -> None:
        """Multiply by grain of several sizes, each with this share of the brightness; aspect stretches it along u."""
        width, height = self.size_px
        total = np.full((height, width), 128.0, dtype=np.float32)
        for cell in cells_px:
            cell_px = max(1.0, cell)
            rows, columns = max(2, round(height / cell_px) + 2), max(2, round(width / cell_px / aspect) + 2)
            small = self.rng.integers(0, 256, (rows, columns)).astype(np.uint8)
            smooth = cv2.resize(small, (width, height), interpolation=cv2.INTER_CUBIC)
            total += strength * (smooth.astype(np.float32) - 128.0)
        total = np.clip(total / 128.0, 0.3, 1.7)
        self.image[:] = cv2.multiply(self.image, cv2.merge([total] * 3), dtype=cv2.CV_8U)

    def letters(self, box: tuple[int, int, int, int], colour: Colour) -> None:
        """Random words inside a box (x, y, width, height)."""
        x, y, width, height = box
        if width < 6 or height < 5:
            return
        letters = "".join(chr(int(c)) for c in self.rng.integers(65, 91, int(self.rng.integers(3, 9))))
        scale = min(height / 24.0, width / (20.0 * len(letters)))
        if scale < 0.12:
            return
        font = int(self.rng.choice([cv2.FONT_HERSHEY_SIMPLEX, cv2.FONT_HERSHEY_TRIPLEX, cv2.FONT_HERSHEY_COMPLEX]))
        thickness = max(1, round(2.2 * scale))
        cv2.putText(self.image, letters, (x, y + height - 1), font, scale, colour, thickness, cv2.LINE_AA)

    def shapes(self, count: int, smallest_px: float, largest_px: float) -> None:
        """Scatter polygons, discs, rings and strokes."""
        rng = self.rng
        for _ in range(count):
            centre = rng.uniform([0, 0], self.size_px)
            radius = float(np.exp(rng.uniform(np.log(smallest_px), np.log(largest_px))))
            colour = self.random_colour(10, 250)
            kind = rng.integers(0, 5)
            at = (int(centre[0]), int(centre[1]))
            if kind <= 1:
                corners = int(rng.integers(3, 7))
                angles = np.sort(rng.uniform(0, 2 * np.pi, corners))
                reach = radius * rng.uniform(0.5, 1.0, corners)
                points = centre + np.stack([np.cos(angles), np.sin(angles)], axis=1) * reach[:, None]
                cv2.fillPoly(self.image, [np.round(points).astype(np.int32)], colour, cv2.LINE_AA)
            elif kind <= 3:
                line = -1 if kind == 2 else max(1, int(radius * 0.2))
                cv2.circle(self.image, at, max(1, int(radius * 0.7)), colour, line, cv2.LINE_AA)
            else:
                end = centre + rng.normal(0, radius, 2)
                line = max(1, int(radius * 0.15))
                cv2.line(self.image, at, (int(end[0]), int(end[1])), colour, line, cv2.LINE_AA)

    def marks(self, per_m2: float, smallest_mm: float, largest_mm: float) -> None:
        """Small sharp marks, darker or lighter than what they lie on: specks, chips, strokes, prints, grain."""
        rng, (width, height) = self.rng, self.size_px
        count = int(per_m2 * width * height / self.texels_per_m**2)
        xs, ys = rng.uniform(0, width, count).astype(int), rng.uniform(0, height, count).astype(int)
        sizes = np.exp(rng.uniform(np.log(smallest_mm), np.log(largest_mm), count)) * 1e-3 * self.texels_per_m / 2
        tones = np.where(rng.random(count) < 0.6, rng.uniform(0.35, 0.75, count), rng.uniform(1.25, 1.7, count))
        tints = rng.uniform(0.85, 1.15, (count, 3))
        colours = np.clip(self.image[ys, xs] * tones[:, None] * tints, 0, 255).astype(int)
        angles, kinds = rng.uniform(0, np.pi, count), rng.integers(0, 3, count)
        columns = (xs, ys, sizes, colours, angles, kinds)
        for x, y, size, colour, angle, kind in zip(*(column.tolist() for column in columns), strict=True):
            r = max(1, round(size))
            flat = max(1, r // 2)
            if kind == 0:
                cv2.ellipse(self.image, (x, y), (r, flat), float(np.degrees(angle)), 0, 360, colour, -1)
            elif kind == 1:
                dx, dy = round(1.6 * r * float(np.cos(angle))), round(1.6 * r * float(np.sin(angle)))
                cv2.line(self.image, (x - dx, y - dy), (x + dx, y + dy), colour, flat)
            else:
                cv2.rectangle(self.image, (x - r, y - flat), (x + r, y + r), colour, -1)

    def grain(self, per_m2: float) -> None:
        """Thin dark and light lines along u, as veneer and planks have them."""
        rng, (width, height) = self.rng, self.size_px
        for _ in range(int(per_m2 * width * height / self.texels_per_m**2)):
            x, y = self.spot()
            length = self.length_px(0.01, 0.12)
            tone = float(rng.uniform(0.45, 0.75) if rng.random() < 0.65 else rng.uniform(1.15, 1.4))
            b, g, r = (int(c) for c in self.image[y, x])
            end = (x + length, y + int(rng.normal(0, 0.03) * length))
            cv2.line(self.image, (x, y), end, scaled((b, g, r), tone), max(1, self.length_px(0.0008, 0.003)))

    def paragraph(self) -> None:
        """A block of small print."""
        rng, (width, height) = self.rng, self.size_px
        line = self.length_px(0.012, 0.03)
        w, rows = int(rng.uniform(0.3, 0.8) * width), int(rng.integers(2, 6))
        x, y = int(rng.uniform(0, max(1, width - w))), int(rng.uniform(0, max(1, height - rows * line)))
        colour = self.random_colour(0, 255)
        for k in range(rows):
            part = int(w * rng.uniform(0.15, 0.3))
            for column in range(0, w - part, part + line):
                self.letters((x + column, y + k * line, part, int(0.75 * line)), colour)

    def edge(self, colour: Colour, width_px: int) -> None:
        width, height = self.size_px
        cv2.rectangle(self.image, (0, 0), (width - 1, height - 1), colour, max(1, width_px) * 2)
