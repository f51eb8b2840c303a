"""What a person who holds the board is told next: which views there are, which are missing, which count."""

from __future__ import annotations

from collections import Counter
from enum import Enum

import cv2
import numpy as np

from shared.calibration import CameraCalibration
from shared.geometry import FloatArray, IntArray
from station.calibration.guidance import MAX_BLUR_PX, MIN_CORNERS, Guidance
from station.calibration.target import BoardView, Target
from station.vision.lens import Lens

CELLS = 3  # by as many: corners at the picture's edge tell the distortion
CELL_CORNERS = 40  # that fill a cell
CELL_NAMES = (
    ("upper left corner", "upper edge", "upper right corner"),
    ("left edge", "middle", "right edge"),
    ("lower left corner", "lower edge", "lower right corner"),
)
LEAST_VIEWS, MAX_VIEWS = 6, 80  # of fewer hardly any estimate is accepted; more take long and add little
LEAST_TILT = np.tan(np.radians(15.0))  # less tells focal length from distance hardly
NEAR, FAR = 0.65, 0.40  # the board's diagonal over the picture's
STILL = 0.010  # of the picture's width that corners move between two looks; more is blurred and skewed by the shutter
NEW = 0.06  # of the picture's width that corners must have moved since any earlier view


class Pose(Enum):
    """How the board is held."""

    FLAT = "hold the board flat to the camera"
    NEAR = "bring it nearer, so that it fills the picture"
    FAR = "take it farther away"
    LEFT = "tilt it: its left edge nearer"
    RIGHT = "tilt it: its right edge nearer"
    UPPER = "tilt it: its upper edge nearer"
    LOWER = "tilt it: its lower edge nearer"


# How many views of each there should be: tilt tells the focal length, nearness the distortion.
WANTED: dict[Pose, int] = {
    Pose.FLAT: 3,
    Pose.NEAR: 4,
    Pose.LEFT: 3,
    Pose.RIGHT: 3,
    Pose.UPPER: 3,
    Pose.LOWER: 3,
    Pose.FAR: 2,
}


class Guide:
    """Chooses the views that tell something new, and says which are missing."""

    def __init__(self, target: Target, camera: CameraCalibration) -> None:
        """`camera` as it is told: only the poses' names depend on it."""
        self._corners = target.corners
        self._size = np.array([camera.width, camera.height], dtype=np.float64)
        self._lens = Lens(camera)
        self._last: BoardView | None = None
        self._held: Counter[Pose] = Counter()
        self._filled = np.zeros((CELLS, CELLS), dtype=np.int64)
        self.views: list[BoardView] = []  # those that count

    def look(self, view: BoardView | None) -> Guidance:
        """Take in what a picture shows of the board; None: nothing."""
        last, self._last = self._last, view
        if view is None:
            return self._guidance("hold the board so that the camera sees it", is_taken=False)
        if len(view.ids) < MIN_CORNERS:
            return self._guidance("show more of the board", is_taken=False)
        if last is None or (moved := _moved_px(last, view)) is None or moved > STILL * self._size[0]:
            return self._guidance(f"{self._wish()}, then hold it still", is_taken=False)
        if view.blur_px > MAX_BLUR_PX:
            return self._guidance("the picture is blurred: more light, or turn the focus ring", is_taken=False)
        if not view.ids_are_sure:
            return self._guidance("show the whole board", is_taken=False)
        if len(self.views) >= MAX_VIEWS or not self._is_new(view):
            return self._guidance(self._wish(), is_taken=False)
        self._take(view)
        return self._guidance(self._wish(), is_taken=True)

    def _take(self, view: BoardView) -> None:
        self.views.append(view)
        self._held.update(self.poses_of(view))
        cell = np.clip(view.corners_px / self._size * CELLS, 0, CELLS - 1).astype(np.int64)
        np.add.at(self._filled, (cell[:, 1], cell[:, 0]), 1)

    def _is_new(self, view: BoardView) -> bool:
        moved = [_moved_px(earlier, view) for earlier in self.views]
        return all(distance is None or distance > NEW * self._size[0] for distance in moved)

    def poses_of(self, view: BoardView) -> set[Pose]:
        """How the board is held in a view; several may be true."""
        xy = self._lens.unproject(view.corners_px)
        # Not IPPE: OpenCV's is wrong by 40 degrees for a board whose z axis points straight at the camera.
        found, rotation, translation = cv2.solvePnP(self._corners[view.ids], xy, np.eye(3), np.zeros(4))
        if not found:
            return set()
        R = cv2.Rodrigues(rotation)[0]
        towards = -R[:, 2] if float(R[:, 2] @ translation.ravel()) > 0 else R[:, 2]  # the normal on the camera's side
        slope = towards[:2] / max(1e-6, -towards[2])
        board_m = np.ptp(self._corners, axis=0)
        share = float(np.linalg.norm(board_m) / translation.ravel()[2]) * float(self._lens.focal.mean())
        share /= float(np.linalg.norm(self._size))
        held = {
            Pose.LEFT: slope[0] > LEAST_TILT,
            Pose.RIGHT: slope[0] < -LEAST_TILT,
            Pose.UPPER: slope[1] > LEAST_TILT,
            Pose.LOWER: slope[1] < -LEAST_TILT,
            Pose.FLAT: float(np.hypot(*slope)) < LEAST_TILT,
            Pose.NEAR: share > NEAR,
            Pose.FAR: share < FAR,
        }
        return {pose for pose, is_true in held.items() if is_true}

    def _wish(self) -> str:
        """The pose that is missing, and where in the picture."""
        pose = next((pose for pose, count in WANTED.items() if self._held[pose] < count), None)
        fullness = self._filled / CELL_CORNERS
        row, column = np.unravel_index(int(np.argmin(fullness)), fullness.shape)
        where = f"move it to the {CELL_NAMES[row][column]} of the picture" if fullness[row, column] < 1.0 else ""
        if pose is None and not where:
            return "enough: finish, or go on for still smaller errors"
        return "; ".join(filter(None, (pose.value if pose is not None else "", where)))

    def _guidance(self, instruction: str, is_taken: bool) -> Guidance:
        cells = np.minimum(1.0, self._filled / CELL_CORNERS).ravel().tolist()
        poses = {pose.name.lower(): min(1.0, self._held[pose] / count) for pose, count in WANTED.items()}
        is_enough = all(share >= 1.0 for share in (*cells, *poses.values()))
        may_finish = len(self.views) >= LEAST_VIEWS
        return Guidance(instruction, is_taken, len(self.views), tuple(cells), poses, may_finish, is_enough)


def _moved_px(earlier: BoardView, later: BoardView) -> float | None:
    """How far the corners that both views have moved, on average; None where they share too few."""
    common: IntArray
    common, a, b = np.intersect1d(earlier.ids, later.ids, return_indices=True)
    if len(common) < MIN_CORNERS // 2:
        return None
    step: FloatArray = earlier.corners_px[a] - later.corners_px[b]
    return float(np.linalg.norm(step, axis=1).mean())
