"""How far off printed plates are read: warped pictures of words for rooms, oblique, blurred and noisy.

    python -m benchmarks.bench_plates --first 9000 --tries 50

Needs the extra `ocr`. A plate is read right when the line that is read, spelled as in the list of words, is its text.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2
import matplotlib
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from benchmarks.result import Figure, Run, add_results_option, share
from shared.geometry import FloatArray
from station.model.frames import ImageArray
from station.places.naming.plates import plate_name
from station.places.naming.room_words import default_words
from station.vision.printed import PrintReader

FOCALS_PX = {"33 degrees": 1083.0, "56 degrees": 600.0}  # 640 pixels wide
DISTANCES_M = (1.0, 1.5, 2.0, 3.0)
CAPITAL_M = 0.03  # height of a capital letter
OTHER_PLATES = ("Room 2.14", "R 107", "Anna", "Dr. Weber", "2.14")
WIDTH, HEIGHT, FINER = 640, 480, 4  # drawn four times as fine, then reduced as a pixel does
FONT_PX, RIM_PX, PLATE_PX = 120, 80, 300


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=9000, help="first seed")
    parser.add_argument("--tries", type=int, default=50, help="at each distance")
    add_results_option(parser, "plates")
    args = parser.parse_args()
    run = Run.begin()
    figures: list[Figure] = []
    words = default_words()
    texts = [text for word in words.rooms for text in (word.name, *word.written)] + list(OTHER_PLATES)
    read = PrintReader()
    for camera, focal in FOCALS_PX.items():
        for distance in DISTANCES_M:
            right, misread = 0, []
            for seed in range(args.first, args.first + args.tries):
                rng = np.random.default_rng(seed)
                text = texts[rng.integers(len(texts))]
                lines = read(plate_seen(rng, text, distance, focal))
                found = [name for line in lines if (name := plate_name(line, words)) is not None]
                if "".join(found).replace(" ", "").casefold() == text.replace(" ", "").casefold():
                    right += 1
                elif found:
                    misread.append(f"{text}: {' / '.join(found)}")
            print(
                f"{camera}, {distance} m: {right} of {args.tries} read, {len(misread)} misread {misread or ''}",
                flush=True,
            )
            figures.append(share(f"{camera}, {distance} m: a plate read", right, args.tries))
            figures.append(share(f"{camera}, {distance} m: a plate misread", len(misread), args.tries))
    run.write(args.results, figures)
    return 0


def plate_seen(rng: np.random.Generator, text: str, distance_m: float, focal_px: float) -> ImageArray:
    """A picture (480, 640, 3) of a plate that is turned by up to 40 degrees and hangs near the optical axis."""
    plate, m_per_px = _plate(rng, text)
    half = np.array([plate.shape[1], plate.shape[0]]) * m_per_px / 2
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * np.append(half, 0.0)
    at = [*rng.uniform(-0.1, 0.1, 2) * distance_m, distance_m]
    p_cam = corners @ _turned(np.deg2rad(rng.uniform(-40, 40)), np.deg2rad(rng.uniform(-15, 15))).T + at
    uv = p_cam[:, :2] / p_cam[:, 2:] * focal_px + [WIDTH / 2, HEIGHT / 2]
    on_plate = np.array([[0, 0], [plate.shape[1], 0], plate.shape[::-1], [0, plate.shape[0]]], dtype=np.float32)
    H = cv2.getPerspectiveTransform(on_plate, (uv * FINER).astype(np.float32))
    seen = np.full((HEIGHT * FINER, WIDTH * FINER), rng.integers(90, 180), np.uint8)
    cv2.warpPerspective(plate, H, seen.shape[::-1], dst=seen, borderMode=cv2.BORDER_TRANSPARENT)
    small = cv2.resize(seen, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA).astype(np.float64)
    soft = cv2.GaussianBlur(small, (0, 0), rng.uniform(0.5, 1.2))
    moved_px = int(rng.integers(1, 5))
    moved = cv2.filter2D(soft, -1, np.full((1, moved_px), 1 / moved_px))
    noisy = np.clip(moved + rng.normal(0, 3, moved.shape), 0, 255).astype(np.uint8)
    encoded = cv2.imencode(".jpg", noisy, [cv2.IMWRITE_JPEG_QUALITY, 80])[1]
    return np.asarray(cv2.imdecode(encoded, cv2.IMREAD_COLOR), dtype=np.uint8)


def _plate(rng: np.random.Generator, text: str) -> tuple[ImageArray, float]:
    """The plate as printed (300, W), and how large its pixels are, m."""
    faces = sorted(Path(matplotlib.get_data_path(), "fonts", "ttf").glob("DejaVuS*.ttf"))
    faces = [face for face in faces if "Display" not in face.name and "Oblique" not in face.name]
    font = ImageFont.truetype(str(faces[rng.integers(len(faces))]), FONT_PX)
    width = round(font.getlength(text)) + 2 * RIM_PX
    image = Image.new("L", (width, PLATE_PX), 235)
    ImageDraw.Draw(image).text((RIM_PX, RIM_PX), text, fill=25, font=font)
    _, top, _, bottom = font.getbbox("H")
    return np.array(image), CAPITAL_M / (bottom - top)


def _turned(yaw_rad: float, pitch_rad: float) -> FloatArray:
    (cy, sy), (cp, sp) = ((np.cos(a), np.sin(a)) for a in (yaw_rad, pitch_rad))
    return np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]]) @ np.array([[1, 0, 0], [0, cp, -sp], [0, sp, cp]])


if __name__ == "__main__":
    raise SystemExit(main())
