"""A recording that was waved before a target, read as the batch estimate takes it."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Protocol

import numpy as np

from shared.calibration import Calibration, CameraCalibration
from shared.errors import DataError
from shared.geometry import FloatArray
from shared.sensor_yaml import consumer_imu
from station.calibration import CALIBRATE_CAMERA
from station.calibration.assumed import assumed_noise
from station.calibration.boards import make_finder, view_board
from station.calibration.camera_imu.calibrate import HandheldRecording
from station.calibration.target import BoardView, Target
from station.datasets import Dataset, open_dataset
from station.model.frames import ImageArray, ImageFrame, ImuBatch

IMAGES_PER_S = 10.0  # more say little more of one motion
MAX_THREADS = 4  # that look for the target
# How well a lens is known whose file does not say it: of a focal length and a centre 0.3 % of the image's width, and
# what a calibration from 30 images leaves open of the distortion.
SIGMA_OF_WIDTH = 0.003
SIGMA_DISTORTION = {"radtan": (0.01, 0.01, 0.001, 0.001), "equidistant": (0.005, 0.005, 0.005, 0.005)}


class Steps(Protocol):
    """Follows what is done; counted where `total` is given."""

    def step(self, description: str, total: int | None = None) -> None: ...

    def advance(self) -> None: ...


def open_thinned(dataset: Path) -> Dataset:
    """With about IMAGES_PER_S images a second."""
    data = open_dataset(dataset)
    times = data.frame_times_ns
    if len(times) < 2:
        return data
    step = int(1e9 / IMAGES_PER_S / max(float(np.median(np.diff(times))), 1.0) + 1e-3)
    return open_dataset(dataset, step=step) if step > 1 else data


def read_recording(
    data: Dataset, target: Target, lens: CameraCalibration, known: Calibration, steps: Steps
) -> HandheldRecording:
    """The recording with the target found in its images; without an IMU they need not be looked at."""
    imu = data.imu or ImuBatch(np.zeros(0, dtype=np.int64), np.zeros((0, 3)), np.zeros((0, 3)))
    views, notes = views_of(data, target, lens, steps) if len(imu) else ([], [])
    noise = known.imu or consumer_imu(200.0)
    return HandheldRecording(
        views=views,
        num_images=len(data.frame_times_ns),
        imu=imu,
        target=target,
        camera=lens,
        noise=noise,
        gravity=known.gravity,
        sigma_intrinsics=lens_sigma(lens),
        notes=[*notes, *assumed_noise(noise)],
    )


def views_of(data: Dataset, target: Target, lens: CameraCalibration, steps: Steps) -> tuple[list[BoardView], list[str]]:
    """The views of the target, and what is to be said about images that cannot be read.

    Raises:
        DataError: the images are not of the lens' size.
    """
    steps.step("looking for the target", len(data.frame_times_ns))
    assert data.read_frames is not None
    finder = make_finder(target)

    def look(frame: ImageFrame) -> BoardView | str | None:
        try:
            grey = frame.grey()
        except DataError as exc:
            return str(exc)
        check_size(grey, lens, data)
        view = view_board(finder, target, grey, frame.name, frame.t_robot_ns)
        return view if view is not None and view.ids_are_sure else None

    views: list[BoardView] = []
    unreadable: list[str] = []
    with ThreadPoolExecutor(min(MAX_THREADS, os.cpu_count() or 1)) as pool:  # OpenCV computes outside Python's lock
        for found in pool.map(look, data.read_frames()):
            steps.advance()
            if isinstance(found, BoardView):
                views.append(found)
            elif found is not None:
                unreadable.append(found)
    notes = [f"not used: {len(unreadable)} images cannot be read, the first: {unreadable[0]}"] if unreadable else []
    return views, notes


def check_size(grey: ImageArray, lens: CameraCalibration, data: Dataset) -> None:
    height, width = grey.shape
    if (width, height) != (lens.width, lens.height):
        raise DataError(
            f"{data.path}: an image has {width}x{height} pixels, the lens was calibrated with {lens.width}x"
            f"{lens.height}; {CALIBRATE_CAMERA} with images of {width}x{height} and give --camera"
        )


def lens_sigma(lens: CameraCalibration) -> FloatArray:
    """(8,) of fx, fy, cx, cy px and the distortion."""
    return np.array([*[SIGMA_OF_WIDTH * lens.width] * 4, *SIGMA_DISTORTION[lens.model]])
