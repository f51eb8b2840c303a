"""A navigation of a few poses and landmarks."""

from __future__ import annotations

import cv2
import numpy as np

from shared.calibration import REFERENCE_ROBOT
from shared.geometry import se3, so3_exp
from station.model.navigation import Keyframes, Landmarks, Navigation, NavigationReport, Trajectory


def small_navigation(num_landmarks: int = 7) -> Navigation:
    rng = np.random.default_rng(1)
    t = np.array([1403715273262142976, 1403715273312143104, 1403715273362143105])
    poses = np.stack([se3(so3_exp(rng.normal(size=3)), rng.normal(size=3)) for _ in t])
    png = cv2.imencode(".png", np.zeros((4, 4), np.uint8))[1].tobytes()
    jpg = cv2.imencode(".jpg", np.zeros((4, 4), np.uint8))[1].tobytes()
    cov = np.broadcast_to(np.diag([1.0, 2.0, 4.0]), (num_landmarks, 3, 3)).copy()
    observed = np.arange(num_landmarks)
    return Navigation(
        id="kitchen",
        calibration=REFERENCE_ROBOT,
        trajectory=Trajectory(t, poses),
        keyframes=Keyframes(np.array([0, 4]), t[[0, 2]], poses[[0, 2]], (png, jpg), np.array([0, 1])),
        landmarks=Landmarks(
            rng.normal(size=(num_landmarks, 3)),
            rng.integers(0, 256, (num_landmarks, 3)).astype(np.uint8),
            cov,
            np.concatenate([observed, observed[:3]]),
            np.concatenate([np.ones(num_landmarks, np.int64), np.zeros(3, np.int64)]),
            rng.uniform(0, 480, (num_landmarks + 3, 2)),
        ),
        report=NavigationReport(
            "sfm", 5, 0.1, 1.0, 10.0, 1.0, num_landmarks, 0.0, "metric", True, 3, {"numpy": "2"}, {"a": 1}, ("fine",)
        ),
    )
