"""What the servos of the camera's head are off by, learned from images that were recognised while it turned.

An image tells which way the camera looks in the map, odometry how the body has turned. Where odometry's frame is turned
to in the map is one unknown more, so that a heading that came from an image with the head aside says nothing of the
servo that had it aside: only other angles do, and straight ahead, where the servos err by nothing (motion/head.py).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shared.calibration import HeadCalibration
from shared.geometry import FloatArray
from station.model.frames import DriveSample
from station.motion.head import (
    AHEAD,
    NUM_ERRORS,
    PLAY,
    SIGMA_PLAY_RAD,
    Aim,
    HeadPose,
    HeadTrack,
    errors_before_the_drive,
)
from station.places.tracking.config import BeliefConfig

HEADING = 0  # of odometry's frame in the map; the servos' errors follow
ERRORS = slice(1, 1 + NUM_ERRORS)
UNKNOWN_RAD = np.pi  # sigma of a heading that nobody knows
GATE = 16.0  # squared Mahalanobis distance of azimuth and elevation: once in three thousand
MOST_REFUSED = 4  # in a row: then it is the heading that was wrong


@dataclass(frozen=True, slots=True, eq=False)
class SureView:
    """Which way the camera's head looked in the map at an image whose pose was expected, and is believed."""

    R_map_head: FloatArray  # (3, 3)
    sigma_rad: float
    R_nav_body: FloatArray  # (3, 3) by odometry then
    frame: tuple[int, int]  # within one of these odometry's frame lies in the map as it lay


class ServoLearner:
    """A Kalman filter over that heading and the servos' errors. Pure: the data's times only."""

    def __init__(self, calibration: HeadCalibration | None, config: BeliefConfig) -> None:
        self._track = HeadTrack(calibration)
        self._config = config
        self._mean = np.zeros(1 + NUM_ERRORS)
        self._cov = np.zeros((1 + NUM_ERRORS, 1 + NUM_ERRORS))
        if calibration is not None:
            root = errors_before_the_drive(calibration)
            self._cov[ERRORS, ERRORS] = root @ root.T
        self._frame: tuple[int, int] | None = None
        self._R_nav_body = np.eye(3)  # at the last view
        self._refused = 0
        self._t_ns: int | None = None
        self._head: HeadPose | None = None  # at the last image

    def on_drive(self, drive: DriveSample) -> None:
        self._track.add(drive)

    def aim(self, t_ns: int) -> Aim:
        """Where the head has the camera in an image of this time, by what is known of its servos."""
        since_ns = t_ns if self._t_ns is None else min(self._t_ns, t_ns)
        head = self._head = self._track.pose(t_ns, since_ns)
        self._t_ns = t_ns
        if head is None:
            return AHEAD
        self._move_play(head.sigma_change)
        by_errors = head.by_errors
        cov = by_errors @ self._cov[ERRORS, ERRORS] @ by_errors.T
        return Aim(head.T_body_head(by_errors @ self._mean[ERRORS]), float(np.sqrt(np.trace(cov))))

    def learn(self, view: SureView) -> None:
        """From the image that `aim` was asked for last."""
        head = self._head
        if head is None:
            return
        self._follow(view)
        forward = view.R_map_head[:, 0]
        heading = float(np.arctan2(view.R_nav_body[1, 0], view.R_nav_body[0, 0]))
        seen = np.array([np.arctan2(forward[1], forward[0]), np.arcsin(np.clip(forward[2], -1.0, 1.0))])
        H = np.zeros((2, 1 + NUM_ERRORS))
        H[0, HEADING] = 1.0
        H[:, ERRORS] = head.by_errors
        residual = seen - (head.angles + np.array([heading, 0.0]) + H @ self._mean)
        residual[0] = (residual[0] + np.pi) % (2 * np.pi) - np.pi
        S = H @ self._cov @ H.T + view.sigma_rad**2 * np.eye(2)
        if float(residual @ np.linalg.solve(S, residual)) > GATE:
            self._refused += 1
            return
        self._refused = 0
        K = np.linalg.solve(S, H @ self._cov).T
        self._mean = self._mean + K @ residual
        cov = self._cov - K @ S @ K.T
        self._cov = 0.5 * (cov + cov.T)

    def _follow(self, view: SureView) -> None:
        """The heading up to this view: odometry has drifted, or begun anew."""
        if view.frame != self._frame or self._refused >= MOST_REFUSED:
            self._cov[HEADING] = self._cov[:, HEADING] = 0.0
            self._cov[HEADING, HEADING] = UNKNOWN_RAD**2
            self._frame, self._refused = view.frame, 0
        else:
            R = self._R_nav_body.T @ view.R_nav_body
            turn = abs(float(np.arctan2(R[1, 0], R[0, 0])))
            sigma = float(np.sqrt(self._cov[HEADING, HEADING]))
            walked = self._config.walk_rad_per_root_rad**2 * turn
            self._cov[HEADING, HEADING] = (np.sqrt(sigma**2 + walked) + self._config.drift * turn) ** 2
        self._R_nav_body = view.R_nav_body

    def _move_play(self, sigma_change: FloatArray) -> None:
        """What backlash and trembling add: a Gauss-Markov process, as in the filter of SLAM."""
        change = np.minimum(sigma_change, SIGMA_PLAY_RAD)
        stay = np.ones(1 + NUM_ERRORS)
        play = slice(ERRORS.start + PLAY.start, ERRORS.start + PLAY.stop)
        stay[play] = np.sqrt(1.0 - (change / SIGMA_PLAY_RAD) ** 2)
        self._mean = stay * self._mean
        self._cov = stay[:, None] * self._cov * stay
        self._cov[play, play] += np.diag(change**2)
