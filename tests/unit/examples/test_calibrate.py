"""examples/calibrate_camera.py on boards whose camera is known."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from shared.sensor_yaml import read_bare_camera
from tests.support.paths import ROOT

EXAMPLE = ROOT / "examples" / "calibrate_camera.py"
K = np.array([[520.0, 0, 330.0], [0, 515.0, 236.0], [0, 0, 1.0]])


def picture(seed: int) -> bytes:
    """A board of 40 px squares, seen from somewhere by a camera without distortion."""
    rng = np.random.default_rng(seed)
    board = np.full((9 * 40, 12 * 40), 255, np.uint8)
    for i in range(7):
        for j in range(10):
            if (i + j) % 2 == 0:
                board[40 * (i + 1) : 40 * (i + 2), 40 * (j + 1) : 40 * (j + 2)] = 0
    R = cv2.Rodrigues(rng.uniform(-0.5, 0.5, 3))[0]
    t = np.array([*rng.uniform(-60, 60, 2), rng.uniform(480, 800)])
    centre = np.array([[1, 0, -240.0], [0, 1, -180.0], [0, 0, 0], [0, 0, 1]])
    H = K @ np.column_stack([R, t]) @ centre
    seen = cv2.warpPerspective(board, H, (640, 480), flags=cv2.INTER_AREA, borderValue=200.0)
    return bytes(cv2.imencode(".jpg", cv2.GaussianBlur(seen, (0, 0), 0.7))[1].tobytes())


def test_a_known_camera_is_found_and_its_yaml_can_be_read(tmp_path: Path) -> None:
    for seed in range(40):
        (tmp_path / f"{seed:02d}.jpg").write_bytes(picture(seed))
    done = subprocess.run([sys.executable, str(EXAMPLE), str(tmp_path)], capture_output=True, text=True, check=True)
    (tmp_path / "camera.yaml").write_text(done.stdout)
    camera = read_bare_camera(tmp_path / "camera.yaml")
    assert (camera.width, camera.height) == (640, 480)
    assert (camera.fx, camera.fy) == pytest.approx((520.0, 515.0), rel=0.01)
    assert (camera.cx, camera.cy) == pytest.approx((330.0, 236.0), abs=4.0)


def test_too_few_boards_are_refused_in_a_sentence(tmp_path: Path) -> None:
    (tmp_path / "one.jpg").write_bytes(picture(1))
    done = subprocess.run([sys.executable, str(EXAMPLE), str(tmp_path)], capture_output=True, text=True, check=False)
    assert done.returncode == 1 and "needs 8" in done.stderr and "Traceback" not in done.stderr
