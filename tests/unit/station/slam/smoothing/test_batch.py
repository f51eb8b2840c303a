"""Keyframes are thinned without losing the motion between them."""

from __future__ import annotations

import numpy as np
import pytest

from shared.calibration import ImuNoise
from station.model.frames import ImageFrame
from station.motion.preintegration import ImuSegment, preintegrate
from station.slam.smoothing.batch import thinned
from station.slam.smoothing.keyframe import SmoothKeyframe
from station.slam.ukf.memory import RecentFrame
from station.vision.klt import TrackedFrame

pytestmark = pytest.mark.computing

NOISE = ImuNoise(gyro_density=1.7e-4, accel_density=2e-3, gyro_walk=2e-5, accel_walk=3e-3, rate_hz=200.0)


def keyframe(number: int) -> SmoothKeyframe:
    none = TrackedFrame(np.zeros(0, dtype=np.int64), np.zeros((0, 2)), np.zeros((0, 2)), 0, 0, 0)
    t_ns = 150_000_000 * number
    source = RecentFrame(ImageFrame(number, t_ns, 0, b""), none, t_ns, None, None, None, None)
    steps = np.full(30, 0.005)
    imu = ImuSegment(steps, np.full((30, 3), 0.1), np.full((30, 3), 5.0), t_ns, np.zeros(3), np.ones((30, 2)))
    link = preintegrate(imu, np.zeros(6), NOISE) if number else None
    return SmoothKeyframe(
        number, source, none, link, None, 3, False, np.eye(4), np.zeros(3), np.zeros(6), np.zeros(3), 0,
        np.zeros(0, dtype=np.int64), None,
    )  # fmt: skip


@pytest.mark.parametrize("count", [7, 8, 41])
def test_thinned_keyframes_span_the_same_time_with_the_first_and_the_newest(count: int) -> None:
    whole = [keyframe(k) for k in range(count)]
    few = thinned(whole, 5)
    assert len(few) <= 5
    assert (few[0].number, few[-1].number) == (0, count - 1)
    links = [k.link for k in few[1:]]
    assert all(link is not None for link in links)
    assert sum(link.duration_s for link in links if link is not None) == pytest.approx(0.15 * (count - 1))
    assert sum(k.frames_since for k in few[1:]) == 3 * (count - 1)


def test_few_keyframes_stay_as_they_are() -> None:
    whole = [keyframe(k) for k in range(4)]
    assert thinned(whole, 5) is whole
