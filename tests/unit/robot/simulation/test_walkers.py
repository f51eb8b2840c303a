"""Persons walk smoothly through free floor and rooms, and the camera sees them where they are."""

import math

import numpy as np
import pytest

from robot.simulation.body import CollisionBoxes
from robot.simulation.config import Faults, SimulationConfig, without_imperfections
from robot.simulation.imaging import SimulatedCamera
from robot.simulation.renderer import Renderer
from robot.simulation.world import Walker
from robot.simulation.worlds import make_world
from shared.calibration import REFERENCE_CAMERA
from shared.geometry import FloatArray, se3, yaw_rotation

STEP_S = 0.05


def walked(walker: Walker) -> FloatArray:
    """(N, 3) x, y, yaw every STEP_S, once round and a bit further."""
    return np.array([walker.pose(t) for t in np.arange(0.0, walker.times_s[-1] + 2.0, STEP_S)])


@pytest.mark.parametrize(("name", "seed"), [("plain", 0), ("plain", 4), ("plain", 9), ("home", 2), ("lookalike", 1)])
def test_persons_walk_on_free_floor_from_room_to_room_at_a_walking_pace(name: str, seed: int) -> None:
    world = make_world(name, seed, SimulationConfig(walkers=2))
    assert len(world.walkers) == 2
    for walker in world.walkers:
        assert min(np.diff(walker.times_s)) >= 0
        way = walked(walker)
        assert CollisionBoxes(world).clearance(way[:, :2]).min() > 0.1
        speed = np.hypot(*np.diff(way[:, :2], axis=0).T) / STEP_S
        assert 0.5 < speed.max() < 1.2  # nobody jumps, at the end of a round neither
        turn = np.abs((np.diff(way[:, 2]) + math.pi) % (2 * math.pi) - math.pi) / STEP_S
        assert turn.max() < 8.0
        assert len({world.room_at(x, y) for x, y, _ in way} - {""}) >= 2
        moves = np.hypot(*np.diff(way[:, :2], axis=0).T) > 0.4 * STEP_S
        ahead = np.cos(np.arctan2(*np.diff(way[:, :2], axis=0).T[::-1]) - way[:-1, 2])
        assert ahead[moves].mean() > 0.9  # face where they go


def test_plain_homes_have_persons_now_and_then_and_flats_only_where_asked() -> None:
    assert {len(make_world("plain", seed).walkers) for seed in range(12)} >= {0, 1}
    assert not make_world("home", 1).walkers
    assert not make_world("plain", 1, SimulationConfig(walkers=0)).walkers
    one, other = (make_world("plain", 1, SimulationConfig(walkers=1, walkers_seed=k)).walkers for k in (0, 1))
    assert one[0].x_m != other[0].x_m


def test_the_camera_sees_a_person_where_the_person_is() -> None:
    world = make_world("checker", 0, SimulationConfig(walkers=1))
    walker = world.walkers[0]
    renderer = Renderer(world, REFERENCE_CAMERA)
    empty = Renderer(make_world("checker", 0), REFERENCE_CAMERA)
    R_body_cam = REFERENCE_CAMERA.T_body_cam_matrix[:3, :3]
    for t_s in np.linspace(0.0, walker.times_s[-1], 7):
        x, y, _ = walker.pose(float(t_s))
        towards = math.atan2(2.0 - y, 2.0 - x)  # from the middle of the room there is a metre of space
        eye = np.array([x + 1.0 * math.cos(towards), y + 1.0 * math.sin(towards), 0.5])
        T = se3(yaw_rotation(towards + math.pi) @ R_body_cam, eye)
        seen = renderer.render(T[None], float(t_s))
        is_person = (seen.surface >= len(world.surfaces)) & (seen.inverse_depth > 0)
        assert is_person[:, 220:420].mean() > 0.3
        nearest = 1.0 / seen.inverse_depth[is_person]
        assert 0.5 < np.median(nearest) < 1.2
        plain = empty.render(T[None])
        difference = np.abs(seen.image.astype(int) - plain.image)[~is_person]
        assert difference.mean() < 0.2  # of rounding: the textures lie elsewhere in the atlas


def test_a_person_leaves_the_picture_by_walking_on() -> None:
    world = make_world("plain", 0, SimulationConfig(walkers=1))
    camera = SimulatedCamera(Renderer(world, REFERENCE_CAMERA), REFERENCE_CAMERA, without_imperfections().camera, 0)
    walker = world.walkers[0]
    x, y, yaw = walker.pose(0.0)
    T = se3(yaw_rotation(yaw), np.array([x - 1.2 * math.cos(yaw), y - 1.2 * math.sin(yaw), 0.3]))
    first, standing, gone = (
        camera.expose(lambda _t: T, t, Faults()).image.astype(int) for t in (0.0, 0.5, 0.5 * walker.times_s[-1])
    )
    assert np.abs(first - standing).mean() < 0.01 < 1.0 < np.abs(first - gone).mean()
