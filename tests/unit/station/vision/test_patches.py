"""Patches found again in pictures that show them bent, shifted, brighter, or not at all."""

from __future__ import annotations

import numpy as np
import pytest

from shared.geometry import FloatArray
from station.model.frames import ImageArray
from station.vision.patches import Anchors, Patches, smoothed

SIZE = 160
CENTRES = np.array([[50.0, 60.0], [90.0, 100.0], [110.0, 52.0]])
IDS = np.arange(len(CENTRES))
STRAIGHT, STAYS = np.eye(2), np.zeros(2)


def texture(
    seed: int = 0, A: FloatArray = STRAIGHT, shift: FloatArray = STAYS, contrast: float = 1.0
) -> tuple[ImageArray, FloatArray]:
    """A picture that is known between its pixels, bent about its middle and shifted; and where CENTRES are in it."""
    rng = np.random.default_rng(seed)
    middle = np.full(2, 0.5 * SIZE)
    v, u = np.mgrid[:SIZE, :SIZE].astype(np.float64)
    at = (np.stack([u, v], axis=-1) - middle - shift) @ np.linalg.inv(A).T + middle
    waves = rng.uniform(-0.6, 0.6, (40, 2))  # rad per pixel
    phases = rng.uniform(0.0, 2.0 * np.pi, 40)
    grey = 120 + contrast * 8 * np.cos(at @ waves.T + phases).sum(axis=-1)
    return np.clip(np.rint(grey), 0, 255).astype(np.uint8), (CENTRES - middle) @ A.T + middle + shift


TURN = np.array([[np.cos(0.15), -np.sin(0.15)], [np.sin(0.15), np.cos(0.15)]])


@pytest.mark.parametrize("A", [np.eye(2), TURN, np.diag([1.15, 0.9]), np.array([[1.0, 0.12], [0.0, 1.0]])])
def test_a_bent_patch_is_found_to_a_twentieth_of_a_pixel(A: FloatArray) -> None:
    first, _ = texture()
    later, true = texture(A=A, shift=np.array([2.3, -1.75]))
    at, bend, good = Patches.cut(smoothed(first), IDS, CENTRES).found(smoothed(later), true + np.array([0.7, -0.5]))
    assert good.all()
    assert np.abs(at - true).max() < 0.05
    assert np.abs(bend - A).max() < 0.02


def test_brightness_and_contrast_do_not_count() -> None:
    first, _ = texture()
    later, true = texture(shift=np.array([0.4, 0.3]), contrast=0.6)
    at, _, good = Patches.cut(smoothed(first), IDS, CENTRES).found(smoothed(later), true + 0.5)
    assert good.all()
    assert np.abs(at - true).max() < 0.05


def test_another_thing_is_not_taken_for_it() -> None:
    other, _ = texture(1)
    assert not Patches.cut(smoothed(texture()[0]), IDS, CENTRES).found(smoothed(other), CENTRES)[2].any()


def test_a_corner_keeps_its_number_until_it_looks_otherwise() -> None:
    anchors, (later, true) = Anchors(), texture(A=TURN)
    numbers, _ = anchors.seen(smoothed(texture()[0]), IDS, CENTRES)
    again, at = anchors.seen(smoothed(later), IDS, true + 0.4)  # as one that drifted
    assert set(again) == set(numbers)
    assert np.abs(at[np.argsort(again)] - true).max() < 0.05
    other, at = anchors.seen(smoothed(texture(1)[0]), IDS, true)
    assert not set(other) & set(numbers)
    assert np.array_equal(at, true)


def test_no_corners_are_no_fault() -> None:
    numbers, at = Anchors().seen(smoothed(texture()[0]), np.zeros(0, dtype=np.int64), np.zeros((0, 2)))
    assert len(numbers) == len(at) == 0
