import cv2
import numpy as np
import pytest
import scipy.ndimage

from shared.geometry import FloatArray
from station.vision.patch_alignment import Float32Array, align, find_patches, noise_of, warped

HALF = 6


def blobs(seed: int) -> Float32Array:
    grey = np.random.default_rng(seed).standard_normal((60, 60))
    grey = np.asarray(cv2.GaussianBlur(grey, (0, 0), 2.0), dtype=np.float64)
    return (120.0 + 20.0 * grey / grey.std()).astype(np.float32)


def shifted(grey: Float32Array, shift: FloatArray) -> Float32Array:
    return np.asarray(scipy.ndimage.shift(grey, shift[::-1], order=3, mode="nearest"), dtype=np.float32)


def middle(grey: Float32Array) -> Float32Array:
    return grey[30 - HALF : 30 + HALF + 1, 30 - HALF : 30 + HALF + 1]


@pytest.mark.parametrize("shift", [[0.0, 0.0], [0.3, -0.2], [-0.5, 0.45]])
def test_patch_is_found_to_a_part_of_a_pixel_whatever_the_contrast_and_the_slope_of_the_light(
    shift: list[float],
) -> None:
    grey = blobs(0)
    slope = np.add.outer(0.8 * np.arange(60.0), -1.5 * np.arange(60.0)).astype(np.float32)
    image = 0.7 * shifted(grey, np.array(shift)) + slope
    places, is_near = align(image, middle(grey)[None], np.array([[30.0, 30.0]]))
    assert is_near.all()
    np.testing.assert_allclose(places[0], [30.0 + shift[0], 30.0 + shift[1]], atol=0.03)


def test_patch_that_is_not_near_is_not_found() -> None:
    grey = blobs(0)
    assert not align(shifted(grey, np.array([4.0, 3.0])), middle(grey)[None], np.array([[30.0, 30.0]]))[1].any()


def test_patch_slides_along_an_edge_and_is_less_sure_where_contrast_is_low() -> None:
    edge = 0.1 * blobs(1) + np.repeat([[0.0] * 30 + [100.0] * 30], 60, axis=0).astype(np.float32)
    noise = noise_of(middle(edge.astype(np.float32)), 2.0)
    assert noise[1, 1] > 20.0 * noise[0, 0]
    strong, weak = (noise_of(middle((scale * blobs(1)).astype(np.float32)), 5.0) for scale in (1.0, 0.02))
    assert np.linalg.det(weak) > 10.0 * np.linalg.det(strong)


def test_many_patches_in_one_call_are_found_as_each_alone() -> None:
    image, middles = blobs(0), np.array([[20.0, 22.0], [40.0, 31.0], [3.0, 30.0], [-20.0, 30.0], [30.0, 40.0]])
    patches = np.stack([middle(np.roll(image, (30 - int(v), 30 - int(u)), (0, 1))) for u, v in middles])
    patches[4] = middle(blobs(1))  # is nowhere
    ellipses, near = np.tile(9.0 * np.eye(2), (5, 1, 1)), middles + np.array([0.7, -1.2])
    places, found = find_patches(image, patches, near, ellipses, 5, 0.9)
    assert found.tolist() == [True, True, False, False, False]
    np.testing.assert_allclose(places[:2], middles[:2], atol=0.02)
    for i in range(5):
        one = slice(i, i + 1)
        place, is_there = find_patches(image, patches[one], near[one], ellipses[one], 5, 0.9)
        assert is_there.tolist() == found[one].tolist()
        np.testing.assert_array_equal(place, places[one])


def test_no_patches_are_found_nowhere() -> None:
    none, nowhere = np.zeros((0, 2, 2)), np.zeros((0, 2))
    places, found = find_patches(blobs(0), warped([], none, 11), nowhere, none, 5, 0.9)
    assert places.shape == (0, 2) and found.shape == (0,)
