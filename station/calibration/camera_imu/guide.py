"""What a person who waves the robot before a target is told next: which motion is missing, and for how long."""

from __future__ import annotations

import numpy as np

from shared.calibration import CameraCalibration
from shared.geometry import FloatArray, so3_log
from station.calibration.camera_imu.start import camera_poses
from station.calibration.guidance import MAX_BLUR_PX, MIN_CORNERS, Guidance
from station.calibration.target import BoardView, Target
from station.vision.lens import Lens

WANTED_S = 30.0  # of the target in view
LEAST_TIME = 0.5  # of that; less is hardly ever accepted
WANTED_TURN_RAD = 6.0  # about each axis, to and fro: twice what the verdict asks of 30 s
WANTED_SWING = 0.3  # of the distance: pushes the accelerometer, which tells where it sits
MAX_GAP_S = 1.0  # between two pictures: longer ago, and how it turned meanwhile is not known
SLOW_RAD_S = 0.15  # so slowly it does not get there
FAR = 0.25  # of the picture's width that the target takes, at least
TILT, TURN, ROLL, DISTANCE, TIME = "tilt", "turn", "roll", "distance", "time"
WISHES = {
    TILT: "tilt the robot up and down, briskly",
    TURN: "turn it left and right, briskly",
    ROLL: "roll it, as one turns a steering wheel",
    DISTANCE: "move it nearer and farther",
}


class WavingGuide:
    """Follows how the robot was waved, from the target in its pictures alone."""

    def __init__(self, target: Target, camera: CameraCalibration) -> None:
        self._target, self._lens, self._width = target, Lens(camera), camera.width
        self._last: tuple[float, FloatArray] | None = None  # s, T_target_cam of the newest picture
        self._turned = np.zeros(3)  # rad about the camera's axes
        self._nearest, self._farthest = np.inf, 0.0
        self._seconds = 0.0
        self.views: list[BoardView] = []  # those that show enough of the target

    def look(self, view: BoardView | None) -> Guidance:
        """Take in what a picture shows of the target; None: nothing."""
        if view is None or len(view.ids) < MIN_CORNERS or not view.ids_are_sure:
            return self._guidance("keep the whole board in view", is_taken=False)
        poses = camera_poses([view], self._target, self._lens, 0)
        if not len(poses.t_s):
            return self._guidance("keep the whole board in view", is_taken=False)
        self.views.append(view)
        rate = self._follow(float(poses.t_s[0]), poses.T_target_cam[0])
        if np.ptp(view.corners_px[:, 0]) < FAR * self._width:
            return self._guidance("go nearer: the board should fill half of the picture", is_taken=True)
        if view.blur_px > MAX_BLUR_PX:
            return self._guidance("the picture is blurred: wave more slowly, or take more light", is_taken=True)
        slow = rate is not None and rate < SLOW_RAD_S
        return self._guidance(self._wish(slow), is_taken=True)

    def _follow(self, t_s: float, T_target_cam: FloatArray) -> float | None:
        """Angular rate (rad/s) since the picture before; None where that is too long ago."""
        distance = float(np.linalg.norm(T_target_cam[:3, 3] - self._target.corners.mean(axis=0)))
        self._nearest, self._farthest = min(self._nearest, distance), max(self._farthest, distance)
        last, self._last = self._last, (t_s, T_target_cam)
        if last is None or not 0.0 < t_s - last[0] <= MAX_GAP_S:
            return None
        turn = so3_log(last[1][:3, :3].T @ T_target_cam[:3, :3])
        self._turned += np.abs(turn)
        self._seconds += t_s - last[0]
        return float(np.linalg.norm(turn)) / (t_s - last[0])

    def _shares(self) -> dict[str, float]:
        """How much of each motion that is wanted there was, 0..1."""
        swing = self._farthest / self._nearest - 1.0 if self._farthest else 0.0
        shares = [*(self._turned / WANTED_TURN_RAD), swing / WANTED_SWING, self._seconds / WANTED_S]
        names = (TILT, TURN, ROLL, DISTANCE, TIME)  # a camera tilts about its x axis, turns about y, rolls about z
        return {name: min(1.0, float(share)) for name, share in zip(names, shares, strict=True)}

    def _wish(self, is_slow: bool) -> str:
        shares = self._shares()
        missing = min(WISHES, key=lambda name: shares[name])
        if shares[missing] < 1.0:
            return WISHES[missing]
        if shares[TIME] < 1.0:
            left = f"go on for {WANTED_S - self._seconds:.0f} s"
            return f"{left}, faster" if is_slow else left
        return "enough: finish, or go on for still smaller errors"

    def _guidance(self, instruction: str, is_taken: bool) -> Guidance:
        shares = self._shares()
        is_enough = all(share >= 1.0 for share in shares.values())
        return Guidance(instruction, is_taken, len(self.views), (), shares, shares[TIME] >= LEAST_TIME, is_enough)
