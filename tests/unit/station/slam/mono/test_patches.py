import cv2
import numpy as np
import pytest

from shared.geometry import FloatArray
from station.model.frames import ImageArray
from station.slam.mono.config import MonoConfig
from station.slam.mono.patches import PatchFinder
from station.slam.mono.state import State
from station.vision.lens import Lens
from tests.support.mono import hand_held_camera

SHIFT_PX = 8  # to the right
NOTHING = State.first(MonoConfig())


def sizes(noise: FloatArray) -> FloatArray:
    """Of how many sigma_px the pixels are measured on the mean of both directions; a shrunk picture's are larger."""
    return np.asarray(np.linalg.det(noise) ** 0.25)


def picture(contrast: float, blur_px: float, shift_px: int, seed: int) -> ImageArray:
    """Blobs of one size and of so many grey levels, under the noise of a small camera."""
    shades = np.random.default_rng(0).standard_normal((480, 640 + SHIFT_PX))
    shades = np.asarray(cv2.GaussianBlur(shades, (0, 0), blur_px), dtype=np.float64)
    shades *= contrast / shades.std()
    view = shades[:, SHIFT_PX - shift_px : SHIFT_PX - shift_px + 640]
    noise = np.random.default_rng(seed).normal(0.0, 1.5, view.shape)
    return np.clip(np.rint(120.0 + view + noise), 0, 255).astype(np.uint8)


@pytest.mark.parametrize(("contrast", "blur_px", "is_sharp"), [(40.0, 3.0, True), (6.0, 16.0, False)])
def test_features_of_sharp_corners_or_else_of_shades_are_found_where_they_have_moved(
    contrast: float, blur_px: float, is_sharp: bool
) -> None:
    camera, config = hand_held_camera().camera, MonoConfig()
    assert camera is not None
    lens = Lens(camera)
    finder = PatchFinder(lens, config)
    finder.look_at(picture(contrast, blur_px, 0, 1))
    uv, noise = finder.new_features(NOTHING, np.arange(20))
    assert len(uv) >= 10 and ((sizes(noise) < config.coarse) == is_sharp).all()
    ids = np.arange(len(uv))
    state = State.first(config).with_features(ids, uv, noise, lens, config, config.sigma_px)
    state, _ = state.moved(config, 1.0 / 30.0)
    finder.look_at(picture(contrast, blur_px, SHIFT_PX, 2))
    inside = np.flatnonzero(uv[:, 0] + SHIFT_PX < 580)
    found_px, found = finder.find(state, state.expect(lens, inside, config.sigma_px))
    assert found.mean() > 0.8
    off = found_px[found] - uv[inside][found] - [SHIFT_PX, 0.0]
    assert np.abs(np.median(off, axis=0)).max() < (0.03 if is_sharp else 0.3)
    assert np.sqrt((off**2).mean()) < (0.05 if is_sharp else 0.5)


def test_no_coarse_feature_is_taken_where_there_are_enough_sharp_ones() -> None:
    camera = hand_held_camera().camera
    assert camera is not None
    config = MonoConfig(num_measured=10)
    finder = PatchFinder(Lens(camera), config)
    finder.look_at(picture(40.0, 3.0, 0, 1))
    uv, noise = finder.new_features(NOTHING, np.arange(20))
    assert len(uv) == 10 and (sizes(noise) < config.coarse).all()
