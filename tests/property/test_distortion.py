"""Laws of lens distortion as calibration uses it: derivatives, and agreement with the lens that a camera is used by."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shared.calibration import CameraCalibration
from station.calibration.distortion import COUNT, LENS_NAMES, LensName, distort, distortion_slopes
from station.vision.lens import Lens

lenses = st.sampled_from(LENS_NAMES)
seeds = st.integers(0, 2**32 - 1)


def draw(lens: LensName, seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return rng.uniform(-0.8, 0.8, (20, 2)), rng.uniform(-0.1, 0.1, COUNT[lens])


@given(lens=lenses, seed=seeds)
def test_derivatives_agree_with_differences(lens: LensName, seed: int) -> None:
    xy, d = draw(lens, seed)
    found, h = distortion_slopes(lens, xy, d), 1e-6
    for axis in range(2):
        step = h * np.eye(2)[axis]
        slope = (distort(lens, xy + step, d) - distort(lens, xy - step, d)) / (2 * h)
        assert found.by_xy[:, :, axis] == pytest.approx(slope, abs=1e-7)
    for k in range(COUNT[lens]):
        step = h * np.eye(COUNT[lens])[k]
        slope = (distort(lens, xy, d + step) - distort(lens, xy, d - step)) / (2 * h)
        assert found.by_d[:, :, k] == pytest.approx(slope, abs=1e-7)


@given(lens=st.sampled_from(["radtan", "equidistant"]), seed=seeds)
def test_a_calibrated_lens_is_the_lens_that_is_used(lens: LensName, seed: int) -> None:
    xy, d = draw(lens, seed)
    model = "equidistant" if lens == "equidistant" else "radtan"
    camera = CameraCalibration(
        width=640, height=480, fx=640.0, fy=640.0, cx=0.0, cy=0.0, model=model, distortion=tuple(d.tolist())
    )
    assert distort(lens, xy, d) == pytest.approx(Lens(camera).project(xy) / 640.0, abs=1e-12)
