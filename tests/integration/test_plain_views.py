"""What a camera sees of a plain home: fewer corners than in a flat, and now and then next to none."""

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
from tests.support.corners import strong_corners

pytestmark = pytest.mark.computing

NUM_VIEWS = 20
SETTLE_FRAMES = 3  # of the auto-exposure after each jump along the route


def corners_along_the_mapping_route(name: str, seed: int) -> FloatArray:
    """Number of strong corners (NUM_VIEWS,) in views ahead, evenly spaced along the route."""
    config = SimulationConfig()
    world = make_world(name, seed, config)
    points = plan_route(world, "mapping").points
    camera = SimulatedCamera(Renderer(world, REFERENCE_CAMERA), REFERENCE_CAMERA, config.camera, seed)
    counts = []
    for k in np.linspace(0, len(points) - 5, NUM_VIEWS).astype(int):
        dx, dy = points[k + 4] - points[k]
        T = se3(yaw_rotation(math.atan2(dy, dx)), np.array([*points[k], config.body.imu_height_m]))
        for _ in range(SETTLE_FRAMES):
            image = camera.expose(lambda _t, T=T: T, 0.0, config.faults).image
        counts.append(strong_corners(np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), dtype=np.uint8))[1])
    return np.array(counts, dtype=np.float64)


def test_the_median_view_of_plain_homes_has_40_to_120_corners_and_some_show_next_to_none() -> None:
    plain = np.concatenate([corners_along_the_mapping_route("plain", seed) for seed in range(4)])
    flat = corners_along_the_mapping_route("home", 0)
    assert 40 <= np.median(plain) <= 120
    assert np.mean(plain < 30) >= 0.05  # a tenth of what a flat shows
    assert np.median(flat) > 2 * np.median(plain)
