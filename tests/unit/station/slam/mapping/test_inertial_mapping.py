"""A map laid on the inertial readings, of which some landmarks are on somebody who walks by."""

from __future__ import annotations

import numpy as np

from shared.calibration import REFERENCE_CAMERA, CameraCalibration, ImuNoise
from shared.geometry import FloatArray, transform
from station.model.best_camera import KnownCamera
from station.motion.preintegration import ImuSegment, preintegrate
from station.slam.mapping.camera_fit import CameraFit
from station.slam.mapping.inertial_mapping import lay_on_imu
from station.slam.mapping.inertial_terms import InertialTerms
from station.slam.mapping.odometry_bundle import BundleState
from station.slam.mapping.odometry_mapping import odometry_map
from station.slam.mapping.tracks import Tracks

NOISE = ImuNoise(gyro_density=1e-4, accel_density=1e-2, gyro_walk=1e-5, accel_walk=1e-4, rate_hz=200.0)
STEP_S, VIEWS, DT_S, GRAVITY = 0.4, 25, 0.005, 9.81
WALLS, LEGS = 45, 15  # landmarks
PIXEL = 0.2


def stop_and_go() -> tuple[InertialTerms, FloatArray, FloatArray]:
    """A robot that goes back and forth along x without turning: terms, velocities and positions (VIEWS, 3)."""
    t = np.arange(round(STEP_S * (VIEWS - 1) / DT_S)) * DT_S
    accel = np.stack([np.cos(2.0 * t), np.zeros_like(t), np.full_like(t, GRAVITY)], axis=1)
    v, x = np.zeros((VIEWS, 3)), np.zeros((VIEWS, 3))
    links, n = [], round(STEP_S / DT_S)
    for k in range(VIEWS - 1):
        readings = accel[k * n : (k + 1) * n]
        segment = ImuSegment(np.full(n, DT_S), np.zeros((n, 3)), readings, 0, np.zeros(3), np.ones((n, 6)))
        link = preintegrate(segment, np.zeros(6), NOISE)
        links.append(link)
        fall = np.array([0.0, 0.0, -GRAVITY])
        v[k + 1] = v[k] + link.dv + fall * STEP_S
        x[k + 1] = x[k] + v[k] * STEP_S + link.dp + 0.5 * fall * STEP_S**2
    return InertialTerms(links, NOISE, GRAVITY, np.zeros(6), None), v, x


def seen(points: FloatArray, x: FloatArray, camera: CameraCalibration, rng: np.random.Generator) -> FloatArray:
    """(N, 2) normalised coordinates of points (N, 3), with a pixel's noise."""
    p_cam = transform(camera.T_cam_body_matrix, points - x)
    return p_cam[:, :2] / p_cam[:, 2:] + rng.normal(size=(len(points), 2)) * PIXEL / camera.fx


def test_what_walks_by_does_not_carry_the_map_along() -> None:
    """Its features are off by a pixel or two, which is many times what those of walls are."""
    rng = np.random.default_rng(5)
    terms, v, x = stop_and_go()
    number = WALLS + LEGS
    points = rng.uniform([2.0, -0.6, -0.4], [4.0, 0.6, 0.5], (number, 3))
    walks = np.outer(np.arange(number) >= WALLS, [0.0, 1.0, 0.0])
    rays = [seen(points + 0.012 * np.sin(0.8 * k) * walks, x[k], REFERENCE_CAMERA, rng) for k in range(VIEWS)]
    keyframe, point = np.repeat(np.arange(VIEWS), number), np.tile(np.arange(number), VIEWS)
    tracks = Tracks(keyframe, point, point.copy(), number)
    T = np.tile(np.eye(4), (VIEWS, 1, 1))
    T[:, :3, 3] = x
    state = BundleState(T[:, :3, :3].copy(), x.copy(), points, np.zeros(0))
    camera = CameraFit.started(REFERENCE_CAMERA, KnownCamera(REFERENCE_CAMERA, 0.0))
    made = odometry_map(state, tracks, rays, REFERENCE_CAMERA, 0, 0)
    laid, _ = lay_on_imu(made, T, v, terms, camera, None)
    off = laid.state.p_world_body - x
    assert np.abs(off[:, 1]).max() < 7e-4  # 1.2 mm by a loss of a pixel and a half
