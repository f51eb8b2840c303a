"""The global descriptor that local features are compared with."""

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from tests.support.gist import GistDescriptor

gist = GistDescriptor()


def stripes(angle_deg: float, period_px: float = 12.0) -> npt.NDArray[np.uint8]:
    """A picture (240, 320) of stripes across a direction."""
    y, x = np.mgrid[0:240, 0:320]
    along = x * np.cos(np.radians(angle_deg)) + y * np.sin(np.radians(angle_deg))
    return (127 + 100 * np.sin(2 * np.pi * along / period_px)).astype(np.uint8)


def room(seed: int) -> npt.NDArray[np.uint8]:
    """A picture (240, 320) of some boxes."""
    rng = np.random.default_rng(seed)
    image = np.full((240, 320), 120, np.uint8)
    for _ in range(25):
        x, y = rng.integers(0, 300), rng.integers(0, 220)
        cv2.rectangle(image, (int(x), int(y)), (int(x + rng.integers(10, 80)), int(y + rng.integers(10, 60))),
                      int(rng.integers(0, 255)), -1)  # fmt: skip
    return image


def test_it_has_512_numbers_of_unit_length() -> None:
    described = gist.describe(room(0))
    assert described.shape == (512,) and np.linalg.norm(described) == pytest.approx(1.0, abs=1e-5)


def test_a_direction_has_its_own_numbers() -> None:
    level = gist.describe(stripes(0)).reshape(4, 8, 16).sum(axis=(0, 2))
    steep = gist.describe(stripes(90)).reshape(4, 8, 16).sum(axis=(0, 2))
    assert level.argmax() == 0 and steep.argmax() == 4


def test_other_light_and_a_small_shift_change_less_than_another_room() -> None:
    seen = gist.describe(room(1))
    darker = gist.describe((room(1) * 0.6).astype(np.uint8))
    shifted = gist.describe(np.roll(room(1), 4, axis=1))
    assert min(seen @ darker, seen @ shifted) > seen @ gist.describe(room(2))
    assert seen @ darker > 0.95


def test_a_picture_of_nothing_is_described_without_complaint() -> None:
    assert np.isfinite(gist.describe(np.full((240, 320), 80, np.uint8))).all()
