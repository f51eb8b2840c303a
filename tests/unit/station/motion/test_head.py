"""Where the head is, from what its servos were told."""

import numpy as np
import pytest

from shared.calibration import REFERENCE_HEAD
from shared.geometry import so3_log
from station.model.frames import DriveSample
from station.motion.head import (
    CORRELATION_RAD,
    NUM_ERRORS,
    PAN_KNOTS,
    PLAY,
    SIGMA_PLAY_RAD,
    HeadPose,
    HeadTrack,
    errors_before_the_drive,
)

MS = 1_000_000
LAG_NS = round(REFERENCE_HEAD.lag_s * 1e9)


def head_at(pan: float, tilt: float, pan_rate: float = 0.0) -> HeadPose:
    return HeadPose(REFERENCE_HEAD, np.array([pan, tilt]), np.array([pan_rate, 0.0]), np.zeros(2))


def track(*samples: tuple[int, float]) -> HeadTrack:
    """Times in ms and pans."""
    out = HeadTrack(REFERENCE_HEAD)
    for t_ms, pan in samples:
        out.add(DriveSample(t_ms * MS, 0.0, 0.0, pan, 0.0))
    return out


def angles(head: HeadTrack, t_ms: int) -> np.ndarray:
    """At the time when the servos follow what they were told at t_ms."""
    pose = head.pose(t_ms * MS + LAG_NS, t_ms * MS + LAG_NS - 50 * MS)
    assert pose is not None
    return pose.angles


def test_a_head_that_was_never_turned_and_a_camera_without_one_cost_nothing() -> None:
    assert track((0, 0.0), (50, 0.0)).pose(MS, 0) is None
    fixed = HeadTrack(None)
    fixed.add(DriveSample(0, 0.0, 0.0, 0.5, 0.0))
    assert fixed.pose(MS, 0) is None


def test_between_two_reports_the_head_is_evenly_on_its_way() -> None:
    head = track((0, 0.0), (50, 0.0), (100, 0.04), (150, 0.08))
    assert [float(angles(head, t)[0]) for t in (50, 75, 100, 125, 150, 500)] == pytest.approx(
        [0.0, 0.02, 0.04, 0.06, 0.08, 0.08]
    )


def test_over_a_long_silence_the_head_stayed_until_the_last_moment() -> None:
    head = track((0, 0.1), (10_000, 0.14))
    assert float(angles(head, 9_900)[0]) == 0.1 and 0.1 < float(angles(head, 9_980)[0]) < 0.14


def test_turning_adds_play_and_rest_only_trembling() -> None:
    head = track(*((50 * k, min(0.035 * k, 0.7)) for k in range(60)))
    turns, ends, rests = (head.pose(t * MS + LAG_NS, (t - 50) * MS + LAG_NS) for t in (500, 1050, 2500))
    assert turns is not None and ends is not None and rests is not None
    assert turns.is_turning and not rests.is_turning
    assert ends.sigma_change[0] > turns.sigma_change[0] > rests.sigma_change[0] > 0.0


def test_the_head_moves_with_its_angles_as_its_derivatives_tell() -> None:
    head, off, h = head_at(0.6, -0.3), np.array([0.02, 0.01]), 1e-6
    axes, shifts = head.by_angles(off)
    T = head.T_body_head(off)
    for k in range(2):
        step = np.eye(2)[k] * h
        a, b = head.T_body_head(off - step), head.T_body_head(off + step)
        np.testing.assert_allclose(axes[:, k], so3_log(b[:3, :3] @ a[:3, :3].T) / (2 * h), atol=1e-8)
        np.testing.assert_allclose(shifts[:, k], (b[:3, 3] - a[:3, 3]) / (2 * h), atol=1e-8)
    assert np.abs(T[:3, 3]).max() > 0.05


def test_errors_are_even_between_knots_and_the_lag_counts_with_the_speed() -> None:
    errors = np.zeros(NUM_ERRORS)
    errors[2 : 2 + len(PAN_KNOTS)] = 0.1 * PAN_KNOTS
    errors[-1] = 0.02
    assert (head_at(0.5, 0.3, 0.7).by_errors @ errors) == pytest.approx([0.05 - 0.014, 0.0])
    assert (head_at(9.0, 0.0).by_errors @ errors)[0] == pytest.approx(0.1 * PAN_KNOTS[-1])
    errors[PLAY] = [0.003, 0.004]
    assert (head_at(0.0, 0.0).by_errors @ errors) == pytest.approx([0.003, 0.004])


def test_before_the_drive_the_servos_are_right_ahead_and_off_by_their_sigma_elsewhere() -> None:
    root = errors_before_the_drive(REFERENCE_HEAD)
    sigma = [float(np.linalg.norm((head_at(pan, 0.0).by_errors @ root)[0])) for pan in (0.0, 0.17, 1.05)]
    assert sigma[0] < 0.1 * REFERENCE_HEAD.sigma < sigma[1] < sigma[2]
    assert sigma[2] == pytest.approx(REFERENCE_HEAD.sigma, rel=0.05)


def test_between_two_knots_the_errors_curve_is_straight_to_less_than_half_the_play() -> None:
    def alike(a: float, b: float) -> float:
        return float(np.exp(-0.5 * ((a - b) / CORRELATION_RAD) ** 2))

    a, b = float(PAN_KNOTS[0]), float(PAN_KNOTS[1])
    middle = 0.5 * (a + b)
    variance = 1.0 + 0.5 * (1.0 + alike(a, b)) - alike(a, middle) - alike(b, middle)
    assert REFERENCE_HEAD.sigma * np.sqrt(variance) < 0.5 * SIGMA_PLAY_RAD
