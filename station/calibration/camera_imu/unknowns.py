"""Everything that the batch estimate finds, beside the motion: a border of columns next to the knots' band."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import msgspec
import numpy as np

from shared.calibration import CameraCalibration
from shared.geometry import FloatArray, IntArray, se3, so3_exp
from station.calibration.camera_imu.spline import Motion

MOUNT_ROTATION = slice(0, 3)  # rad, on the right of R_body_cam
MOUNT_POSITION = slice(3, 6)  # m, body
SHIFT, DELAY = 6, 7  # s
GRAVITY = slice(8, 11)  # m/s^2, target
SCALE = 11  # of the target's lengths over what its file says
BEND = slice(12, 15)  # m out of the plane: along x^2, x y, y^2 of half the target's width and height
INTRINSICS = slice(15, 23)  # fx, fy, cx, cy, four of distortion
BIASES = 23  # from here on six per node: gyro, accel
BIAS_EVERY_S = 5.0  # nodes; linear between them


@dataclass(frozen=True, slots=True, eq=False)
class Unknowns:
    motion: Motion
    camera: CameraCalibration  # with T_body_cam, time shift and line delay
    gravity: FloatArray  # (3,) m/s^2, target: points down
    biases: FloatArray  # (nodes, 6) rad/s, m/s^2
    scale: float = 1.0
    bend: FloatArray = field(default_factory=lambda: np.zeros(3))

    @property
    def size(self) -> int:
        """Columns of the border."""
        return BIASES + self.biases.size

    def bias_weights(self, t_s: FloatArray) -> tuple[IntArray, FloatArray]:
        """Node before each time (N,), and the share (N, 2) of it and the next."""
        return bias_weights(t_s - self.motion.start_s, len(self.biases))

    def moved(self, knots: FloatArray, border: FloatArray) -> Unknowns:
        """After a step of the knots (n, 6) and of the border (size,)."""
        return replace(
            self,
            motion=self.motion.moved(knots),
            camera=moved_camera(self.camera, border),
            gravity=self.gravity + border[GRAVITY],
            biases=self.biases + border[BIASES:].reshape(-1, 6),
            scale=self.scale + float(border[SCALE]),
            bend=self.bend + border[BEND],
        )


def bias_nodes(duration_s: float) -> int:
    return int(np.ceil(duration_s / BIAS_EVERY_S)) + 1


def bias_weights(since_s: FloatArray, num_nodes: int) -> tuple[IntArray, FloatArray]:
    """Node before each time (N,) since the first node, and the share (N, 2) of it and the next."""
    position = np.clip(since_s / BIAS_EVERY_S, 0.0, num_nodes - 1 - 1e-9)
    node = np.floor(position).astype(np.int64)
    later = position - node
    return node, np.stack([1.0 - later, later], axis=1)


def intrinsics_of(camera: CameraCalibration) -> FloatArray:
    """(8,)."""
    return np.array([camera.fx, camera.fy, camera.cx, camera.cy, *camera.distortion])


def with_intrinsics(camera: CameraCalibration, values: FloatArray) -> CameraCalibration:
    fx, fy, cx, cy, *distortion = (float(value) for value in values)
    return msgspec.structs.replace(camera, fx=fx, fy=fy, cx=cx, cy=cy, distortion=tuple(distortion))


def moved_camera(camera: CameraCalibration, border: FloatArray) -> CameraCalibration:
    T = camera.T_body_cam_matrix
    T = se3(T[:3, :3] @ so3_exp(border[MOUNT_ROTATION]), T[:3, 3] + border[MOUNT_POSITION])
    return msgspec.structs.replace(
        with_intrinsics(camera, intrinsics_of(camera) + border[INTRINSICS]),
        T_body_cam=tuple(T.ravel().tolist()),
        time_shift_s=camera.time_shift_s + float(border[SHIFT]),
        line_delay_s=camera.line_delay_s + float(border[DELAY]),
    )
