"""A robot's sensors drawn anew for each seed, and what its owner believes of them."""

from __future__ import annotations

import msgspec
import numpy as np

from robot.simulation.calibration.waving import Motion
from shared.calibration import (
    REFERENCE_CAMERA,
    REFERENCE_IMU,
    REFERENCE_ROBOT,
    Calibration,
    CameraCalibration,
    ImuNoise,
)
from shared.geometry import FloatArray, se3, so3_exp

IMU_RATE_HZ = 200.0
MAX_MOUNTING_RAD, MAX_MOUNTING_M = np.radians(6.0), 0.04
MAX_TIME_SHIFT_S, MAX_LINE_DELAY_S = 0.042, 40e-6
GYRO_BIAS_RAD_S, ACCEL_BIAS_M_S2 = 0.015, 0.12  # standard deviations at switch-on
VIBRATION_TAPS = 24  # of the filter's response, which halves from tap to tap


def draw_calibration(rng: np.random.Generator) -> Calibration:
    """The true sensors: any small camera, mounted about as the reference robot's, and an IMU of its class."""
    camera = draw_camera(rng)
    turn = so3_exp(rng.uniform(-MAX_MOUNTING_RAD, MAX_MOUNTING_RAD, 3))
    T = REFERENCE_CAMERA.T_body_cam_matrix @ se3(turn, np.zeros(3))
    T[:3, 3] += rng.uniform(-MAX_MOUNTING_M, MAX_MOUNTING_M, 3)
    camera = msgspec.structs.replace(
        camera,
        T_body_cam=tuple(T.ravel().tolist()),
        time_shift_s=float(rng.uniform(-MAX_TIME_SHIFT_S, MAX_TIME_SHIFT_S)),
        line_delay_s=float(rng.uniform(0.0, MAX_LINE_DELAY_S)),
    )
    return msgspec.structs.replace(REFERENCE_ROBOT, camera=camera, imu=draw_imu(rng))


def draw_camera(rng: np.random.Generator) -> CameraCalibration:
    """Intrinsics of 640x480: two in three with a common lens (radial-tangential), else a wide one (equidistant)."""
    is_wide = rng.random() < 1 / 3
    fx = float(rng.uniform(330, 430) if is_wide else rng.uniform(450, 900))
    k1 = float(rng.uniform(-0.3, -0.05))
    # With k2 above 0.45 k1^2 the lens stays invertible; common ones have 0.8 to 1.2 k1^2.
    radtan = (k1, float(rng.uniform(0.7, 1.2)) * k1**2, *rng.uniform(-5e-4, 5e-4, 2).tolist())
    equidistant = tuple((rng.uniform(-1, 1, 4) * [0.02, 0.01, 0.004, 0.001]).tolist())
    return CameraCalibration(
        width=640,
        height=480,
        fx=fx,
        fy=fx * float(rng.uniform(0.995, 1.005)),
        cx=319.5 + float(rng.uniform(-15, 15)),
        cy=239.5 + float(rng.uniform(-12, 12)),
        model="equidistant" if is_wide else "radtan",
        distortion=equidistant if is_wide else radtan,
        rate_hz=20.0,
    )


def draw_imu(rng: np.random.Generator) -> ImuNoise:
    """Densities and random walks up to three times better or worse than the reference IMU's."""
    factor = (3.0 ** rng.uniform(-1, 1, 4)).tolist()
    return msgspec.structs.replace(
        REFERENCE_IMU,
        rate_hz=IMU_RATE_HZ,
        gyro_density=REFERENCE_IMU.gyro_density * factor[0],
        accel_density=REFERENCE_IMU.accel_density * factor[1],
        gyro_walk=REFERENCE_IMU.gyro_walk * factor[2],
        accel_walk=REFERENCE_IMU.accel_walk * factor[3],
    )


def believed_camera(true: CameraCalibration, knows_lens: bool) -> CameraCalibration:
    """What the owner believes: the reference robot's mounting and no shifts; of the lens its numbers or a guess."""
    mounted = msgspec.structs.replace(
        true, T_body_cam=REFERENCE_CAMERA.T_body_cam, time_shift_s=0.0, line_delay_s=0.0, is_measured=knows_lens
    )
    if knows_lens:
        return mounted
    focal = 0.9 * max(true.width, true.height)
    return msgspec.structs.replace(
        mounted,
        fx=focal,
        fy=focal,
        cx=(true.width - 1) / 2,
        cy=(true.height - 1) / 2,
        model="radtan",
        distortion=(0.0, 0.0, 0.0, 0.0),
    )


class SimulatedInertial:
    """An IMU with its biases: readings of whole stretches at once."""

    def __init__(self, noise: ImuNoise, gravity: float, rng: np.random.Generator) -> None:
        self._noise, self._rng = noise, rng
        self._gravity = np.array([0.0, 0.0, gravity])
        self._walk = np.array([noise.gyro_walk] * 3 + [noise.accel_walk] * 3) / np.sqrt(noise.rate_hz)
        self._white = np.array([noise.gyro_density] * 3 + [noise.accel_density] * 3) * np.sqrt(noise.rate_hz)
        switch_on = np.array([GYRO_BIAS_RAD_S] * 3 + [ACCEL_BIAS_M_S2] * 3)
        self.bias = switch_on * rng.standard_normal(6)  # gyro, accel; now

    def read(self, motion: Motion) -> tuple[FloatArray, FloatArray]:
        """Readings (N, 6), rad/s and m/s^2, and the biases (N, 6) in them."""
        force = np.einsum("nji,nj->ni", motion.R_world_body, motion.a_world + self._gravity)
        return self.disturb(np.concatenate([motion.omega_body, force], axis=1))

    def disturb(self, true: FloatArray) -> tuple[FloatArray, FloatArray]:
        """What it makes of true rates and forces (N, 6)."""
        count = len(true)
        biases = self.bias + np.cumsum(self._walk * self._rng.standard_normal((count, 6)), axis=0)
        self.bias = biases[-1]
        read = true + biases + self._white * self._rng.standard_normal((count, 6))
        limit = np.array([self._noise.gyro_range] * 3 + [self._noise.accel_range] * 3)
        return np.clip(read, -limit, limit), biases


def vibration(rng: np.random.Generator, count: int) -> FloatArray:
    """Shaking (count, 6) of unit variance that does not drift, as `robot.simulation.sensors` has it while driving."""
    white = rng.standard_normal((count + VIBRATION_TAPS, 6))
    response = np.sqrt(0.75) * (-0.5) ** np.arange(VIBRATION_TAPS)
    return np.stack([np.convolve(column, response, mode="valid")[:count] for column in white.T], axis=1)
