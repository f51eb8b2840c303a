"""Whether the calibration explains the drive: window after window of its keyframes, while it goes on."""

from __future__ import annotations

from collections import deque
from dataclasses import replace

import numpy as np

from shared.calibration import ImuNoise
from shared.errors import DegenerateGeometry
from station.model.calibration_fit import CalibrationFit, contradicted
from station.slam.mapping.calibration_information import (
    CalibrationInformation,
    calibration_information,
    combined,
    nothing_known,
)
from station.slam.mapping.inertial_bundle import solve_window
from station.slam.ukf.map.keyframes import Keyframe
from station.slam.ukf.map.windows import Spacer, window_of
from station.vision.camera_model import CameraModel

WINDOW = 40  # keyframes, some ten seconds: with fewer, a turn that the bias of the gyroscope explains as well fills one
MIN_KEYFRAMES = 12
MAX_WAITING = 8  # windows; beyond, one is looked at whether or not there is time
# Rotation, velocity, position, biases of the first keyframe. The filter has held the gyroscope's bias for long.
SIGMA_FIRST = np.concatenate([np.full(3, 0.05), np.full(3, 0.3), np.zeros(3), np.full(3, 0.003), np.full(3, 0.1)])


class CalibrationCheck:
    """Grows while the robot drives; bounded.

    Collecting is cheap; a window costs as much as following a few frames and waits until somebody has time for it. What
    comes out is the same whenever that is.
    """

    def __init__(self, camera: CameraModel, noise: ImuNoise, gravity: float) -> None:
        self._camera, self._noise, self._gravity = camera, noise, gravity
        self._spacer = Spacer()
        self._part: list[Keyframe] = []
        self._waiting: deque[list[Keyframe]] = deque()
        self._windows: list[CalibrationInformation] = []
        self.fit: CalibrationFit | None = None  # what the drive so far says
        self._contradictions = 0
        self._last_contradiction_s = 0.0

    def contradict(self, elapsed_s: float) -> None:
        """Tracking was lost, that long after the drive's begin, because image and IMU contradicted each other."""
        self._contradictions += 1
        self._last_contradiction_s = elapsed_s
        self._judge(is_all=False)

    def add(self, keyframe: Keyframe) -> None:
        """Take a keyframe in as the filter leaves it. One of a turned head says nothing: the IMU does not feel it."""
        if keyframe.T_body_head is not None:
            self._end_part()
            return
        if keyframe.link is None or (self._part and keyframe.segment != self._part[-1].segment):
            self._end_part()
            self._spacer = Spacer()
        chosen = self._spacer.add(replace(keyframe, image=replace(keyframe.image, encoded=b"")))
        if chosen is None:
            return
        self._part.append(chosen)
        if len(self._part) == WINDOW:
            self._end_part()
            self._part = [chosen]  # the next window begins where this one ends

    def work(self) -> bool:
        """Look at a window that waits; False when none does."""
        if not self._waiting:
            return False
        part = self._waiting.popleft()
        try:
            window = window_of(part, SIGMA_FIRST)
            given = (window.links, window.tracks, window.prior)
            solved = solve_window(self._camera, self._noise, self._gravity, window.states, *given)
            if solved.has_converged:
                information = calibration_information(
                    self._camera, self._noise, self._gravity, solved.states, *given
                )  # fmt: skip
                self._windows.append(information)
                self._judge(is_all=False)
        except DegenerateGeometry:
            pass  # it says nothing
        return True

    def finish(self) -> CalibrationFit | None:
        """What the whole drive says; None when too little of it was followed."""
        self._end_part()
        while self.work():
            pass
        self._judge(is_all=True)
        return self.fit

    def _judge(self, *, is_all: bool) -> None:
        by_windows = combined(self._windows, is_all=is_all)
        fit = contradicted(by_windows or nothing_known(), self._contradictions, self._last_contradiction_s)
        self.fit = fit if fit.is_contradicted else by_windows

    def _end_part(self) -> None:
        part, self._part = self._part, []
        if len(part) < MIN_KEYFRAMES:
            return
        self._waiting.append(part)
        if len(self._waiting) > MAX_WAITING:
            self.work()
