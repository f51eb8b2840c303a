from dataclasses import replace

import numpy as np
import pytest

from shared.geometry import so3_exp
from station.slam.mono.config import MonoConfig
from station.slam.mono.motion import POSITION
from station.slam.mono.state import State
from station.slam.mono.window import Measured, Window, mirrored
from station.vision.lens import Lens
from tests.support.mono import RATE_HZ, hand_held_camera, hand_held_path

SEED, IMAGES, POINTS = 0, 40, 30
ONES = np.tile(np.eye(2), (POINTS, 1, 1))  # noise of the features


@pytest.fixture(scope="module")
def seen() -> tuple[Lens, list[Measured], State]:
    """Images of points, the first of which slides; and what the filter makes of them one by one."""
    camera, config = hand_held_camera().camera, MonoConfig()
    assert camera is not None
    lens, rng, path = Lens(camera), np.random.default_rng(SEED), hand_held_path(SEED, 2.0).T_world_body
    p = rng.uniform([-0.3, -0.2, 2.0], [0.3, 0.2, 5.0], (POINTS, 3))
    p[:, :2] *= p[:, 2:]
    p = p @ path[0, :3, :3].T + path[0, :3, 3]
    images, state, ids = [], State.first(config), np.arange(POINTS)
    for k, T in enumerate(path[:IMAGES]):
        h = (p - T[:3, 3]) @ T[:3, :3]
        uv = lens.project(h[:, :2] / h[:, 2:]) + rng.normal(0.0, 0.5, (POINTS, 2))
        uv[0] += [0.4 * k, -0.4 * k]
        inside = np.flatnonzero(lens.is_inside(uv, 5.0))
        images.append(Measured(1.0 / RATE_HZ if k else 0.0, inside, uv[inside], inside))
        if k:
            state, _ = state.moved(config, 1.0 / RATE_HZ)
            state = state.updated(state.expect(lens, inside, config.sigma_px), uv[inside])
        else:
            state = state.with_features(ids, uv, ONES, lens, config, config.sigma_px)
    return lens, images, state


def test_start_measures_the_noise_and_leaves_out_the_feature_that_slides(
    seen: tuple[Lens, list[Measured], State],
) -> None:
    lens, images, state = seen
    path, sigma_px = Window(lens, MonoConfig(), State.first(MonoConfig()), images).again(state, 1.0)
    assert sigma_px == pytest.approx(0.5, rel=0.1)
    assert path[-1].ids.tolist() == list(range(1, POINTS))


def test_start_gives_the_state_after_each_image_beginning_where_the_world_is(
    seen: tuple[Lens, list[Measured], State],
) -> None:
    lens, images, state = seen
    path, sigma_px = Window(lens, MonoConfig(), State.first(MonoConfig()), images).again(state, 1.0)
    assert len(path) == len(images)
    np.testing.assert_allclose(path[0].T_world_cam, np.eye(4), atol=1e-9)  # known, by definition
    for each, past in zip(images, path, strict=True):
        image = each.only(past.ids)
        off = past.predict(lens).uv_px[np.searchsorted(past.ids, image.ids)] - image.uv_px
        assert np.sqrt((off**2).mean()) < 1.2 * sigma_px


def test_mirror_image_moves_alike_and_leaves_what_was_known_before(seen: tuple[Lens, list[Measured], State]) -> None:
    lens, config, rng = seen[0], MonoConfig(), np.random.default_rng(SEED)
    uv = rng.uniform([100.0, 100.0], [540.0, 380.0], (POINTS, 2))
    x = np.insert(np.zeros(9), 0, [0.5, -0.2, 1.0])
    start = replace(State.first(config), x=x, R=so3_exp(np.array([0.2, -0.4, 0.1])))
    old, new = np.arange(POINTS), np.arange(POINTS, 2 * POINTS)
    first = start.with_features(old, uv, ONES, lens, config, config.sigma_px)
    state = first.with_features(new, uv[::-1], ONES, lens, config, config.sigma_px)
    x = state.x.copy()
    x[state.rows()[:, 5]] += rng.uniform(-0.1, 0.1, 2 * POINTS)
    x[POSITION] += first.R @ [0.02, 0.03, 0.0]
    state = replace(state, x=x)
    mirror = mirrored(state, first)
    still = replace(state, x=np.concatenate([first.x[:3], x[3:]]))
    moved = state.predict(lens).uv_px[new] - still.predict(lens).uv_px[new]
    off = mirror.predict(lens).uv_px[new] - state.predict(lens).uv_px[new]
    assert np.sqrt((off**2).mean()) < 0.25 * np.sqrt((moved**2).mean())
    assert np.linalg.norm(mirror.x[POSITION] - first.x[POSITION] - first.R @ [-0.02, -0.03, 0.0]) < 1e-9
    np.testing.assert_array_equal(mirror.features()[old], state.features()[old])
    back = mirrored(mirror, first)
    np.testing.assert_allclose(back.x, state.x, atol=1e-9)
    np.testing.assert_allclose(back.R, state.R, atol=1e-9)
