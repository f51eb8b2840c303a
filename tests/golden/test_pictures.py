"""What the simulated camera showed when it was first measured, tile by tile: drawing faster must draw the same.

Made by `python -m tests.golden.test_pictures`. Processors round otherwise, so that single pixels may differ; the mean
of a tile does not move by TOLERANCE for that, but it does for another noise, exposure, lens or way of the robot.
"""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from robot.simulation.atlas import default_cache_dir
from robot.simulation.config import Faults, SimulationConfig
from robot.simulation.imaging import SimulatedCamera
from robot.simulation.renderer import Renderer
from robot.simulation.worlds import make_world
from shared.calibration import REFERENCE_CAMERA
from shared.geometry import FloatArray, se3, so3_exp

GOLDEN = Path(__file__).parent / "pictures.json"
WORLDS = (("home", 3), ("small", 2), ("plain", 3), ("large", 2))
PICTURES = 4
TILE_PX = 80
TOLERANCE = 0.05  # grey levels


def turning(R: FloatArray, p: FloatArray, omega: FloatArray, t0_s: float, t_s: float) -> FloatArray:
    return se3(R @ so3_exp((t_s - t0_s) * omega), p)


def tiles(name: str, seed: int) -> FloatArray:
    """Mean (PICTURES, H / TILE_PX, W / TILE_PX) of each tile, with turns, tilts and somebody in the picture."""
    config = SimulationConfig(walkers=2, light_seed=seed)
    world, camera = make_world(name, seed, config), REFERENCE_CAMERA
    eye = SimulatedCamera(Renderer(world, camera, default_cache_dir()), camera, config.camera, seed)
    rng = np.random.default_rng(seed)
    found = []
    for number in range(PICTURES):
        room = world.rooms[number % len(world.rooms)]
        tilt, turn = so3_exp(rng.normal(0.0, 0.2, 3)), rng.normal(0.0, 0.5, 3)
        R = so3_exp(np.array([0.0, 0.0, rng.uniform(0.0, 6.3)])) @ tilt
        pose = partial(turning, R, np.array([*room.centre, 0.3]), turn, 1.0 + number)
        image = eye.expose(pose, 1.0 + number, Faults(person=number == 3)).image.mean(axis=2)
        found.append(image.reshape(camera.height // TILE_PX, TILE_PX, -1, TILE_PX).mean(axis=(1, 3)))
    return np.array(found)


@pytest.mark.parametrize(("name", "seed"), WORLDS)
def test_the_simulated_camera_shows_what_it_always_showed(name: str, seed: int) -> None:
    assert tiles(name, seed) == pytest.approx(np.array(json.loads(GOLDEN.read_text())[name]), abs=TOLERANCE)


if __name__ == "__main__":
    GOLDEN.write_text(json.dumps({name: tiles(name, seed).round(2).tolist() for name, seed in WORLDS}) + "\n")
