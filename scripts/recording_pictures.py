"""Eight pictures of a recording side by side: python scripts/recording_pictures.py RECORDING OUT.jpg

As docs/images/calibration-views.jpg is made, of a recording by `robot-sim calibration`.
"""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np

from station.datasets import open_dataset
from station.model.frames import ImageArray

COLUMNS, ROWS, WIDTH_PX, GAP_PX = 4, 2, 300, 4


def spread(recording: Path) -> list[ImageArray]:
    """Evenly over the recording."""
    data = open_dataset(recording)
    count = COLUMNS * ROWS
    wanted = np.linspace(0, len(data.frame_times_ns) - 1, count + 2).round().astype(int)[1:-1].tolist()
    assert data.read_frames is not None
    return [frame.grey() for number, frame in enumerate(data.read_frames()) if number in wanted]


def main() -> None:
    recording, out = map(Path, sys.argv[1:3])
    pictures = []
    for grey in spread(recording):
        small = cv2.resize(grey, (WIDTH_PX, WIDTH_PX * grey.shape[0] // grey.shape[1]), interpolation=cv2.INTER_AREA)
        pictures.append(cv2.copyMakeBorder(small, 0, GAP_PX, 0, GAP_PX, cv2.BORDER_CONSTANT, value=255))
    rows = [np.hstack(pictures[COLUMNS * row : COLUMNS * (row + 1)]) for row in range(ROWS)]
    cv2.imwrite(str(out), np.vstack(rows), [cv2.IMWRITE_JPEG_QUALITY, 80])


if __name__ == "__main__":
    main()
