"""Calibrate the robot's camera with a chessboard: prints the camera.yaml of docs/robot.md.

    python examples/calibrate_camera.py http://127.0.0.1:8080 > camera.yaml      # live, through the station
    python examples/calibrate_camera.py FOLDER_OF_JPEGS > camera.yaml

Show a chessboard of 9 x 6 inner corners (10 x 7 squares; also on a flat screen) from all sides: near and far, tilted,
and into each corner of the picture. Live, a picture is taken whenever the board stands somewhere else.
"""

from __future__ import annotations

import argparse
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

BOARD = (9, 6)  # inner corners
WANTED = 25  # pictures
LEAST = 8
MOVED = 0.03  # of the picture's width: nearer to an earlier one, a board tells nothing new

Points = npt.NDArray[np.float32]


@dataclass(frozen=True)
class Calibrated:
    """Pinhole with radial and tangential distortion (OpenCV's first four)."""

    width: int
    height: int
    intrinsics: tuple[float, float, float, float]  # fx fy cx cy, px
    distortion: tuple[float, float, float, float]  # k1 k2 p1 p2
    rms_px: float


def find_board(jpeg: bytes) -> tuple[Points | None, tuple[int, int]]:
    """Corners (54, 2) of the board in a picture, or None; and the picture's width and height."""
    grey = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_GRAYSCALE)
    if grey is None:
        return None, (0, 0)
    found, corners = cv2.findChessboardCornersSB(grey, BOARD)
    return (np.asarray(corners, np.float32).reshape(-1, 2) if found else None), (grey.shape[1], grey.shape[0])


def calibrate(boards: list[Points], size: tuple[int, int]) -> Calibrated:
    """The camera that saw these boards. Source: Zhang, PAMI 22(11), 2000, by OpenCV."""
    grid = np.zeros((BOARD[0] * BOARD[1], 3), np.float32)
    grid[:, :2] = np.mgrid[: BOARD[0], : BOARD[1]].T.reshape(-1, 2)
    rms, K, distortion, _, _ = cv2.calibrateCamera(
        [grid] * len(boards), boards, size, np.eye(3), np.zeros(5), flags=cv2.CALIB_FIX_K3
    )
    k = np.asarray(distortion, dtype=float).ravel()
    return Calibrated(
        *size,
        (float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2])),
        (float(k[0]), float(k[1]), float(k[2]), float(k[3])),
        float(rms),
    )


def pictures(source: str) -> Iterator[bytes]:
    """JPEGs of a folder, or the live ones of a station."""
    if not source.startswith("http"):
        for path in sorted(Path(source).glob("*.jp*g")):
            yield path.read_bytes()
        return
    while True:
        with urllib.request.urlopen(f"{source.rstrip('/')}/camera/frame.jpg", timeout=5) as answer:
            yield answer.read()
        time.sleep(0.3)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("source", help="address of the station, or a folder of pictures")
    source = parser.parse_args().source
    boards: list[Points] = []
    size = (0, 0)
    try:
        for jpeg in pictures(source):
            corners, size = find_board(jpeg)
            if corners is None or any(np.abs(corners - b).mean() < MOVED * size[0] for b in boards):
                continue
            boards.append(corners)
            print(f"{len(boards)} of {WANTED}: board seen", file=sys.stderr)
            if len(boards) == WANTED:
                break
    except (urllib.error.URLError, TimeoutError) as exc:
        sys.exit(f"no picture from {source}: {exc}; is the station running, and the robot connected?")
    if len(boards) < LEAST:
        sys.exit(f"the board was seen in {len(boards)} different places, needs {LEAST}: 9 x 6 inner corners, all seen")
    found = calibrate(boards, size)
    print(f"resolution: [{found.width}, {found.height}]")
    print("camera_model: pinhole")
    print("intrinsics: [" + ", ".join(f"{v:.2f}" for v in found.intrinsics) + "]    # fx fy cx cy, px")
    print("distortion_model: radial-tangential")
    print("distortion_coefficients: [" + ", ".join(f"{v:.4f}" for v in found.distortion) + "]    # k1 k2 p1 p2")
    print(f"{found.rms_px:.2f} px left over; above 1 px, hold the board flatter and stiller", file=sys.stderr)


if __name__ == "__main__":
    main()
