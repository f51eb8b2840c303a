"""Local features lie where things are, and are the same for whoever looks for them."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
import pytest

from station.model.frames import ImageArray
from station.vision.features import (
    FEW_FEATURES,
    MAX_DETAILS,
    MAX_FEATURES,
    DetailExtractor,
    FeatureExtractor,
    Features,
    similarities,
    to_floats,
)
from station.vision.matching import match_both_ways


@pytest.mark.parametrize("width", [320, 640])  # described as it is, and at half its size
def test_the_middle_of_a_blob_is_found_without_bias(width: int) -> None:
    rng = np.random.default_rng(0)
    v, u = np.mgrid[: width * 3 // 4, :width]
    extractor = FeatureExtractor()
    errors = []
    for _ in range(12):
        middle = rng.uniform(0.3, 0.6, 2) * [width, width * 3 // 4]
        size = rng.uniform(0.006, 0.014) * width
        blob = 110.0 * np.exp(-((u - middle[0]) ** 2 + (v - middle[1]) ** 2) / (2.0 * size**2))
        found = extractor.extract((128.0 + blob).astype(np.uint8)).uv_px
        if len(found):
            errors.append(found[np.argmin(np.linalg.norm(found - middle, axis=1))] - middle)
    assert len(errors) >= 8
    # Upscaling that is not precise: a quarter of a pixel of the image that is looked at, so half a pixel at half size.
    assert np.abs(np.mean(errors, axis=0)).max() < 0.1


def patches(number: int, contrast: float) -> ImageArray:
    """A picture (480, 640) of blurred noise, of which a part is stronger than the rest."""
    rng = np.random.default_rng(number)
    noise = cv2.resize(rng.normal(0.0, contrast, (120, 160)), (640, 480), interpolation=cv2.INTER_CUBIC)
    noise[:, :160] *= 4.0
    return np.clip(128.0 + noise, 0, 255).astype(np.uint8)


@pytest.mark.parametrize("up_deg", [None, 0.0])
@pytest.mark.parametrize(("contrast", "rich"), [(4.0, False), (14.0, True)])
def test_details_hold_the_features_bit_for_bit(contrast: float, rich: bool, up_deg: float | None) -> None:
    for number in range(3):
        picture = patches(number, contrast)
        direct = FeatureExtractor(up_deg=up_deg).extract(picture)
        details = DetailExtractor(up_deg).extract(picture)
        assert (len(direct) >= MAX_FEATURES) == rich
        assert np.array_equal(direct.uv_px, details.seen.uv_px)
        assert np.array_equal(direct.descriptors, details.seen.descriptors)
        places = {tuple(uv) for uv in details.features.uv_px.tolist()}
        assert len(places) == len(details.features) == len(details.features.descriptors) <= MAX_DETAILS
        assert {tuple(uv) for uv in direct.uv_px.tolist()} <= places
        assert rich or len(details.features) > 1.2 * len(direct)


@pytest.mark.parametrize("up_deg", [None, 0.0])
def test_details_hold_the_features_of_a_pattern_whose_corners_have_four_directions(up_deg: float | None) -> None:
    rng = np.random.default_rng(3)
    tiles = rng.permuted(np.tile([60, 200], (24 * 32, 1)), axis=1)[:, 0].reshape(24, 32)
    board = np.kron((np.indices((24, 32)).sum(axis=0) % 2) * 120 + 60, np.ones((20, 20)))
    for picture in (board, np.kron(tiles, np.ones((20, 20)))):
        grey = cv2.GaussianBlur(picture.astype(np.uint8), (0, 0), 1.0)
        direct, details = FeatureExtractor(up_deg=up_deg).extract(grey), DetailExtractor(up_deg).extract(grey)
        assert len(direct) >= FEW_FEATURES
        assert np.array_equal(direct.uv_px, details.seen.uv_px)
        assert np.array_equal(direct.descriptors, details.seen.descriptors)


def test_a_camera_on_its_side_sees_the_same_where_it_is_known_what_is_up() -> None:
    square = np.ascontiguousarray(patches(6, 14.0)[:, :480])
    upright = FeatureExtractor(up_deg=0.0).extract(square)
    turned = FeatureExtractor(up_deg=90.0).extract(np.ascontiguousarray(np.rot90(square, -1)))
    expected_uv = np.column_stack([479.0 - upright.uv_px[:, 1], upright.uv_px[:, 0]])  # clockwise
    gap = np.linalg.norm(turned.uv_px[:, None] - expected_uv[None], axis=2)
    here, there = np.flatnonzero(gap.min(axis=1) < 0.5), gap.argmin(axis=1)
    assert len(here) > 0.7 * len(upright)
    alike = np.einsum("ni,ni->n", to_floats(turned.descriptors[here]), to_floats(upright.descriptors[there[here]]))
    assert np.median(alike) > 0.95


def test_an_upright_corner_is_described_once_and_is_another_one_upside_down() -> None:
    picture = patches(7, 14.0)
    upright = FeatureExtractor(up_deg=0.0).extract(picture)
    assert len(np.unique(upright.uv_px, axis=0)) > 0.99 * len(upright)  # one place may hold a large and a small corner
    any_way = FeatureExtractor().extract(picture)
    flipped = np.ascontiguousarray(picture[::-1, ::-1])
    assert pairs_of(any_way, FeatureExtractor().extract(flipped)) > 0.5 * len(any_way)
    assert pairs_of(upright, FeatureExtractor(up_deg=0.0).extract(flipped)) < 0.05 * len(upright)


def pairs_of(one: Features, other: Features) -> int:
    return len(match_both_ways(similarities(one, other), 0.85))


def test_threads_do_not_change_what_is_found() -> None:
    picture = patches(4, 14.0)
    found, before = [], cv2.getNumThreads()
    for threads in (1, 2):
        cv2.setNumThreads(threads)
        found.append((FeatureExtractor().extract(picture), DetailExtractor().extract(picture)))
    cv2.setNumThreads(before)
    (one, one_details), (two, two_details) = found
    assert np.array_equal(one.uv_px, two.uv_px) and np.array_equal(one.descriptors, two.descriptors)
    assert np.array_equal(one_details.features.uv_px, two_details.features.uv_px)
    assert np.array_equal(one_details.features.descriptors, two_details.features.descriptors)


def test_a_blank_picture_has_no_details() -> None:
    details = DetailExtractor().extract(np.full((480, 640), 90, dtype=np.uint8))
    assert len(details.seen) == len(details.features) == len(details.features.descriptors) == 0


@pytest.mark.parametrize("extract", [FeatureExtractor().extract, lambda grey: DetailExtractor().extract(grey).seen])
def test_a_picture_in_the_shade_is_looked_at_again(extract: Callable[[ImageArray], Features]) -> None:
    lit = patches(5, 14.0)
    shaded = np.round(lit * 0.06).astype(np.uint8)
    alone = cv2.SIFT.create(MAX_FEATURES, 3, 0.02, enable_precise_upscale=True)
    half = cv2.resize(shaded, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    assert len(alone.detect(half, None)) < FEW_FEATURES
    found, true = extract(shaded), extract(lit).uv_px
    assert len(found) > FEW_FEATURES
    distance = np.linalg.norm(found.uv_px[:, None] - true[None], axis=2).min(axis=1)
    assert np.mean(distance < 2.0) > 0.5  # corners of the picture, not noise


@pytest.mark.parametrize("up_deg", [None, 0.0])
def test_a_picture_of_a_few_pixels_has_no_features(up_deg: float | None) -> None:
    noise = np.random.default_rng(0).integers(0, 256, (40, 40), dtype=np.uint8)
    for height, width in ((1, 1), (1, 40), (40, 2), (10, 40), (10, 10)):
        assert not len(FeatureExtractor(up_deg=up_deg).extract(noise[:height, :width].copy()))
