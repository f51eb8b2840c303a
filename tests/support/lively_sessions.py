"""What corners of a room look like to a camera that is waved in it, and what its IMU reads: no images, no target.

The motion is that of `calibration_sessions`; the room's frame is that of its target.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shared.calibration import REFERENCE_IMU, CameraCalibration, ImuNoise
from shared.geometry import FloatArray
from station.calibration.camera_imu.rows import Samples
from station.calibration.targetless.rows import Inertial
from station.calibration.targetless.tracks import MAX_IMAGES, MIN_SIGHTINGS, Sightings
from station.calibration.targetless.unknowns import Estimate
from station.model.frames import ImuBatch
from station.vision.lens import Lens
from tests.support.calibration_sessions import (
    IMU_MARGIN_S,
    ORIGIN_NS,
    TARGET,
    HandheldMotion,
    Waving,
    drawn_camera,
    exposed,
)

IMU_RATE_HZ = 200.0
ROOM_M = np.array([[-1.0, -0.8, -2.0], [1.3, 1.0, 0.0]])  # before the camera: it looks along -z
WAVING = Waving(turn_rad=(0.12, 0.12, 0.2), shake_m=0.03)
GRAVITY = np.array([0.3, -9.8, 0.2])  # m/s^2


@dataclass(frozen=True, slots=True, eq=False)
class LivelySession:
    seen: Sightings
    points: FloatArray  # (L, 3) m: where each corner of `seen` lies
    imu: ImuBatch
    camera: CameraCalibration  # the true one
    noise: ImuNoise
    motion: HandheldMotion

    @property
    def inertial(self) -> Inertial:
        return Inertial(self.imu, self.noise, Samples.of(self.imu, self.noise, ORIGIN_NS), ORIGIN_NS)

    def true_estimate(self) -> Estimate:
        """Everything as it was, but for readings without biases."""
        t_s = self.seen.t_s + self.camera.middle_row_shift_s
        (R, p), step_s = self.motion.body(t_s), 1e-4
        v = (self.motion.body(t_s + step_s)[1] - self.motion.body(t_s - step_s)[1]) / (2 * step_s)
        first = np.searchsorted(self.seen.corner, np.arange(self.seen.num_corners))
        k = self.seen.image[first]
        anchor = p[k] + R[k] @ self.camera.T_body_cam_matrix[:3, 3]
        away = self.points - anchor
        distance = np.linalg.norm(away, axis=1)
        return Estimate(
            camera=self.camera,
            gravity=GRAVITY,
            biases=np.zeros((3, 6)),
            t_s=t_s,
            R=R,
            p=p,
            v=v,
            anchor=anchor,
            ray=away / distance[:, None],
            inverse_depth=1.0 / distance,
        )


def make_lively_session(
    seed: int, duration_s: float = 10.0, images_per_s: float = 6.0, num_points: int = 60, is_exact: bool = False
) -> LivelySession:
    """Another camera, room and motion by each seed; `is_exact`: nothing is noisy."""
    rng = np.random.default_rng(seed)
    camera = drawn_camera(rng)
    motion = HandheldMotion(rng, WAVING, TARGET, camera.T_body_cam_matrix)
    noise = REFERENCE_IMU
    t = np.arange(-IMU_MARGIN_S, duration_s + IMU_MARGIN_S, 1 / IMU_RATE_HZ)
    gyro, accel = motion.readings(t, GRAVITY)
    for reading, density, bias in ((gyro, noise.gyro_density, 0.01), (accel, noise.accel_density, 0.05)):
        if not is_exact:
            reading += rng.normal(0.0, density * np.sqrt(IMU_RATE_HZ), reading.shape) + rng.normal(0.0, bias, 3)
    points = rng.uniform(ROOM_M[0], ROOM_M[1], (num_points, 3))
    times = np.arange(0.0, duration_s, 1 / images_per_s) - camera.time_shift_s
    times = times[(times > 0.0) & (times < duration_s)]
    seen, of_point = _sightings(rng, times, camera, motion, points, 0.0 if is_exact else 0.2)
    imu = ImuBatch(ORIGIN_NS + np.round(1e9 * t).astype(np.int64), gyro, accel)
    return LivelySession(seen, points[of_point], imu, camera, noise, motion)


def _sightings(
    rng: np.random.Generator,
    times: FloatArray,
    camera: CameraCalibration,
    motion: HandheldMotion,
    points: FloatArray,
    noise_px: float,
) -> tuple[Sightings, list[int]]:
    """Each point's unbroken runs of images, cut as a tracker's; and of which point each run is."""
    uv, in_view = exposed(times, camera, motion, points)
    runs: list[tuple[int, range]] = []
    for point in range(len(points)):
        edges = np.flatnonzero(np.diff(in_view[:, point], prepend=False, append=False))
        for begin, end in edges.reshape(-1, 2).tolist():
            cuts = [range(at, min(at + MAX_IMAGES, end)) for at in range(begin, end, MAX_IMAGES)]
            runs += [(point, images) for images in cuts if len(images) >= MIN_SIGHTINGS]
    image = np.concatenate([list(images) for _, images in runs])
    corner = np.repeat(np.arange(len(runs)), [len(images) for _, images in runs])
    of_point = [point for point, _ in runs]
    uv_px = uv[image, np.array(of_point)[corner]]
    uv_px = uv_px + rng.normal(0.0, noise_px, uv_px.shape)
    return Sightings(times, image, corner, uv_px, Lens(camera).unproject(uv_px)), of_point
