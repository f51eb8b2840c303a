"""Truth is by the IMU's clock, images by the camera's: whoever looks one up by the other minds the shift."""

from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

from shared.calibration import Calibration
from shared.geometry import FloatArray, se3, yaw_rotation
from station.commands.slam import given_state
from station.datasets import Dataset, Truth
from station.experiments.matches import true_landmarks
from tests.support.synthetic_home import CAMERA, R_BODY_CAM, furnished_room, navigate

SHIFTED = msgspec.structs.replace(CAMERA, time_shift_s=-0.04)  # t_imu = t_cam - 40 ms
T_NS = np.arange(0, 12_000_000_000, 5_000_000, dtype=np.int64)


def turning(t_s: float) -> FloatArray:
    """T_world_cam of a robot on a circle, turning at 0.5 rad/s."""
    angle = 0.5 * t_s
    centre = np.array([2.5 + 0.5 * np.cos(angle), 2.0 + 0.5 * np.sin(angle), 0.4])
    return se3(yaw_rotation(angle) @ R_BODY_CAM, centre)


def test_error_free_slam_is_judged_free_of_error_though_the_clocks_differ() -> None:
    home = furnished_room(3)
    poses = np.array([turning(0.1 * k - 0.04) for k in range(5, 115)])
    navigation = navigate(home, poses, seed=3, noise_m=0.0, outlier_share=0.0, images=False)
    stamps = np.arange(5, 115, dtype=np.int64) * 100_000_000
    navigation = replace(
        navigation,
        calibration=Calibration(camera=SHIFTED, imu=None),
        keyframes=replace(navigation.keyframes, t_robot_ns=stamps),
    )
    truth = Truth(T_NS, np.array([turning(t * 1e-9) for t in T_NS]))
    np.testing.assert_allclose(true_landmarks(navigation, truth), navigation.landmarks.p_world, atol=1e-6)


@pytest.mark.parametrize("line_delay_s", [0.0, 2 * 0.015 / (CAMERA.height - 1)])  # the middle row is 15 ms late
def test_a_given_state_is_the_one_at_the_first_frame(line_delay_s: float) -> None:
    still = np.zeros((len(T_NS), 3))
    truth = Truth(T_NS, np.array([turning(t * 1e-9) for t in T_NS]), still, still, still)
    calibration = Calibration(camera=msgspec.structs.replace(SHIFTED, line_delay_s=line_delay_s), imu=None)
    first = np.array([100_000_000], dtype=np.int64)
    data = Dataset(Path("drive"), "asl", calibration, True, first, None, truth=truth)
    at_s = 0.06 + (0.015 if line_delay_s else 0.0)
    np.testing.assert_allclose(given_state(data).x_world, turning(at_s)[:3, 3], atol=1e-9)
