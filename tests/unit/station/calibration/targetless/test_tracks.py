"""Corners of an ordinary scene, followed through images of which some cannot be used."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from shared.calibration import REFERENCE_CAMERA, REFERENCE_IMU
from shared.errors import DataError
from station.calibration.camera_imu.rows import Samples
from station.calibration.targetless.tracks import Sightings, follow
from station.model.frames import ImageFrame, ImuBatch

STILL = ImuBatch(np.arange(0, 10**9, 5_000_000), np.zeros((200, 3)), np.tile([0.0, 0.0, 9.81], (200, 1)))
TORN = b"\xff\xd8 torn"


def wall() -> bytes:
    """A still picture, full of corners."""
    noise = np.random.default_rng(3).integers(0, 255, (60, 80), dtype=np.uint8)
    picture = cv2.resize(noise, (REFERENCE_CAMERA.width, REFERENCE_CAMERA.height), interpolation=cv2.INTER_CUBIC)
    return cv2.imencode(".png", picture)[1].tobytes()


def followed(images: list[bytes]) -> Sightings:
    frames = [ImageFrame(i, 10**8 * i, 0, image, f"{i}.png") for i, image in enumerate(images)]
    samples = Samples.of(STILL, REFERENCE_IMU, 0)
    return follow(frames, REFERENCE_CAMERA, samples, 0, len(frames), lambda: None)


def test_a_torn_image_is_passed_over_and_named() -> None:
    seen = followed([wall(), wall(), TORN, wall(), wall()])
    assert seen.t_s.tolist() == pytest.approx([0.0, 0.1, 0.3, 0.4])
    assert np.bincount(seen.corner).max() == 4  # followed across the gap
    assert len(seen.notes) == 1 and "1 images cannot be read, the first: image 2.png" in seen.notes[0]
    assert seen.chosen(np.ones(len(seen.image), dtype=bool)).notes == seen.notes


def test_nothing_is_said_of_images_that_can_be_read() -> None:
    assert followed([wall()] * 4).notes == ()


def test_torn_images_alone_are_an_error_that_names_the_first() -> None:
    with pytest.raises(DataError, match=r"none of the images can be used, the first: image 0\.png"):
        followed([TORN, TORN])
