"""The start of a robot that its motors drive: from wheels and a level floor, and never in somebody's hands."""

from __future__ import annotations

import numpy as np
import pytest

from shared.calibration import REFERENCE_ROBOT
from shared.geometry import FloatArray, so3_exp, yaw_rotation
from station.model.frames import DriveSample, ImuBatch
from station.motion.drive_commands import WheelSpeed
from station.motion.error_coordinates import ErrorKind, difference_group
from station.motion.imu_buffer import ImuBuffer
from station.slam.ukf.filter.constraints import Rolled, WheelConfig, wheel_velocity
from station.slam.ukf.filter.state import PHI, XI_V, FilterState
from station.slam.ukf.start.motion_start import MotionStart, StartConfig
from station.slam.ukf.start.starter import Anchor, Starter, WaitingFrame, driven_velocity, state_rolling
from station.vision.camera_model import CameraModel
from station.vision.klt import TrackedFrame

assert REFERENCE_ROBOT.camera is not None and REFERENCE_ROBOT.imu is not None
CAMERA, NOISE, GRAVITY = REFERENCE_ROBOT.camera, REFERENCE_ROBOT.imu, REFERENCE_ROBOT.gravity
NOW_NS = 2 * 10**9
ANCHOR = Anchor(np.array([1.0, 2.0, 0.1]), 0.7, None)
FORWARD = np.array([0.3, 0.0, 0.0])


def readings(accel: FloatArray, seconds: float) -> ImuBuffer:
    """A constant reading of the accelerometer that ends now."""
    imu = ImuBuffer(NOISE)
    t = np.arange(NOW_NS - round(seconds * 1e9), NOW_NS + 1, 5_000_000)
    imu.add(ImuBatch(t, np.zeros((len(t), 3)), np.tile(accel, (len(t), 1))))
    return imu


def attempt(
    accel: FloatArray, seconds: float = 1.0, num_features: int = 80, v_wheels: FloatArray | None = FORWARD
) -> tuple[FilterState, MotionStart | None] | str:
    model = CameraModel.of(CAMERA, 1.0)
    uv = np.random.default_rng(0).uniform(50, 400, (num_features, 2))
    tracked = TrackedFrame(np.arange(num_features), uv, model.lens.unproject(uv), num_features, 100.0)
    starter = Starter(model, NOISE, GRAVITY, StartConfig(), ErrorKind.RIGHT)
    frame = WaitingFrame(7, NOW_NS, tracked, v_wheels)
    return starter.try_start(frame, readings(accel, seconds), False, lambda _: ANCHOR)


@pytest.mark.parametrize("turn_rad_s", [0.0, 1.0, 2.5])
@pytest.mark.parametrize("speed_m_s", [0.1, 0.3, 0.5])
def test_motors_have_followed_half_a_second_after_their_command(speed_m_s: float, turn_rad_s: float) -> None:
    config, wheel = WheelConfig(), WheelSpeed(hold_s=np.inf, efficiency=1.0)
    wheel.add_drive(DriveSample(0, 0.0, turn_rad_s))
    wheel.add_drive(DriveSample(10**9, speed_m_s, turn_rad_s))

    def after(seconds: float) -> FloatArray | None:
        wheel.advance(10**9 + round(seconds * 1e9))
        missing = wheel.missing_m_s
        wheels = wheel_velocity(config, np.array([1.0, 0.0]), turn_rad_s, Rolled(wheel.speed_m_s, missing))
        assert wheels is not None
        return driven_velocity(wheels, config.sigma_lag_share * abs(missing))

    if speed_m_s > 0.2:
        assert after(0.02) is None
    v_body = after(0.5)
    assert v_body is not None
    assert v_body[0] == pytest.approx(speed_m_s, rel=0.1)


def test_a_robot_whose_wheels_say_nothing_of_its_speed_is_not_started_by_them() -> None:
    wheels = wheel_velocity(WheelConfig(), np.array([1.0, 0.0]), 0.0, None)
    assert wheels is not None
    assert driven_velocity(wheels, 0.0) is None


def test_a_driven_robot_starts_at_once_where_it_was_known_to_be() -> None:
    found = attempt(np.array([0.0, 0.0, GRAVITY]))
    assert not isinstance(found, str)
    state, motion = found
    assert motion is None
    np.testing.assert_allclose(state.x, ANCHOR.x_world)
    np.testing.assert_allclose(state.R, yaw_rotation(0.7), atol=1e-9)
    np.testing.assert_allclose(state.v, 0.3 * np.array([np.cos(0.7), np.sin(0.7), 0.0]), atol=1e-9)


@pytest.mark.parametrize(
    ("accel", "seconds", "num_features", "needs"),
    [
        ([0.0, 0.3 * GRAVITY, 0.95 * GRAVITY], 1.0, 80, "stand on its wheels"),  # tilted by 17 degrees
        ([0.0, 0.0, -GRAVITY], 1.0, 80, "stand on its wheels"),
        ([0.0, 0.0, GRAVITY + 1.5], 1.0, 80, "stand on its wheels"),  # lifted
        ([0.0, 0.0, GRAVITY], 0.2, 80, "IMU samples"),
        ([0.0, 0.0, GRAVITY], 1.0, 5, "something to follow"),
    ],
)
def test_it_says_what_is_missing(accel: list[float], seconds: float, num_features: int, needs: str) -> None:
    found = attempt(np.array(accel), seconds, num_features)
    assert isinstance(found, str) and needs in found


def test_what_is_not_driven_waits_for_a_window_of_images() -> None:
    found = attempt(np.array([0.0, 0.0, GRAVITY]), v_wheels=None)
    assert isinstance(found, str) and "images that overlap" in found


@pytest.mark.parametrize("kind", [ErrorKind.RIGHT, ErrorKind.LEFT, ErrorKind.PLAIN])
def test_the_start_is_as_wrong_as_it_says(kind: ErrorKind) -> None:
    """Floors within 1.5 degrees of level, accelerating by up to 0.5 m/s^2, wheels that slip 4 %, skid 3 cm/s."""
    rng = np.random.default_rng(5)
    squared = []
    for _ in range(400):
        tilt = so3_exp(np.array([*rng.normal(0, np.radians(1.5), 2), 0.0]))
        v_body = np.array([0.3 * (1 + rng.normal(0, 0.04)), rng.normal(0, 0.03), rng.normal(0, 0.01)])
        push = np.array([rng.uniform(-0.5, 0.5), rng.uniform(-0.2, 0.2), rng.normal(0, 0.1)])
        R_true = yaw_rotation(0.7) @ tilt
        reading = R_true.T @ np.array([0.0, 0.0, GRAVITY]) + push
        state = state_rolling(NOW_NS, reading, FORWARD, kind, ANCHOR)
        phi, xi = difference_group(kind, state.R, state.v[None], R_true, (R_true @ v_body)[None])
        rows = np.vstack([state.S[PHI], state.S[XI_V]])
        error = np.concatenate([phi, xi[0]])
        squared.append(float(error @ np.linalg.solve(rows @ rows.T, error)))
    # Yaw is a definition, so five degrees of freedom; safe, and not by more than a factor of five.
    assert 1.0 < np.mean(squared) < 6.0
