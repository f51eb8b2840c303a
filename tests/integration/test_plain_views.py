"""What a first look finds in a plain home: far less than in a flat, and on bare walls nearly nothing."""

import math

import cv2
import numpy as np
import pytest

from robot.simulation.config import SimulationConfig
from robot.simulation.imaging import SimulatedCamera
from robot.simulation.renderer import Renderer
from robot.simulation.routes import plan_route
from robot.simulation.worlds import make_world
from shared.calibration import REFERENCE_CAMERA
from shared.geometry import FloatArray, se3, yaw_rotation

pytestmark = pytest.mark.computing

NUM_VIEWS = 20
SETTLE_FRAMES = 3  # of the auto-exposure after each jump along the route


def features_along_the_mapping_route(name: str, seed: int) -> FloatArray:
    """Number of features (NUM_VIEWS,) in views ahead, evenly spaced along the route."""
    config = SimulationConfig()
    world = make_world(name, seed, config)
    points = plan_route(world, "mapping").points
    camera = SimulatedCamera(Renderer(world, REFERENCE_CAMERA), REFERENCE_CAMERA, config.camera, seed)
    sift, counts = cv2.SIFT.create(contrastThreshold=0.02, enable_precise_upscale=True), []
    for k in np.linspace(0, len(points) - 5, NUM_VIEWS).astype(int):
        dx, dy = points[k + 4] - points[k]
        T = se3(yaw_rotation(math.atan2(dy, dx)), np.array([*points[k], config.body.imu_height_m]))
        for _ in range(SETTLE_FRAMES):
            image = camera.expose(lambda _t, T=T: T, 0.0, config.faults).image
        half = cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
        counts.append(len(sift.detect(half, None)))
    return np.array(counts)


def test_the_median_view_of_a_plain_home_has_55_to_120_features_and_bare_walls_nearly_none() -> None:
    plain = np.concatenate([features_along_the_mapping_route("plain", seed) for seed in range(2)])
    flat = features_along_the_mapping_route("home", 0)
    assert 55 <= np.median(plain) <= 120
    assert np.mean(plain < 20) >= 0.05
    assert np.median(flat) > 5 * np.median(plain)
