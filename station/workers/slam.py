"""What runs in a SLAM worker: one backend, following one navigation."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from shared.calibration import Calibration
from shared.errors import EstimationError
from station.files.navigation_folder import PICTURES, save_navigation
from station.model.frames import DepthFrame, DriveSample, ImageFrame, ImuBatch
from station.model.navigation import Navigation, NavigationReport
from station.model.slam_update import SlamUpdate
from station.motion.sensor_order import Sequencer
from station.places.localisation.described_pictures import DescribedPictures
from station.slam.backend import SlamBackend
from station.slam.backends import make_backend
from station.slam.mapping.depth import DepthLog, with_depth
from station.workers.request import Vectors
from station.workers.slam_interface import SlamProgram

logger = logging.getLogger(__name__)


class NavigationSlam(SlamProgram):
    """Follows one navigation; sends a SlamUpdate for every frame."""

    def __init__(self, emit: Callable[[SlamUpdate], None]) -> None:
        self._emit = emit
        self._backend: SlamBackend | None = None
        self._sequencer = Sequencer(0.0, has_imu=False)
        self._depth = DepthLog()
        self._started_s = 0.0
        self._pictures = DescribedPictures()
        self._num_described = 0  # how many of the backend's keyframes were looked at

    def begin(
        self, backend: str, calibration: Calibration, seed: int, threads: int = -1, intrinsics_known: bool = True
    ) -> None:
        camera = calibration.camera
        self._backend = make_backend(backend, calibration, seed, threads, intrinsics_known)
        shift_s = camera.middle_row_shift_s if camera else 0.0
        self._sequencer = Sequencer(shift_s, has_imu=calibration.imu is not None)
        self._pictures = DescribedPictures(calibration.up_in_image_deg)
        self._started_s = time.monotonic()

    def add_imu(self, t_robot_ns: Sequence[int], gyro: Vectors, accel: Vectors) -> None:
        times = np.array(t_robot_ns, dtype=np.int64)
        self._sequencer.add_imu(ImuBatch(times, np.array(gyro, dtype=np.float64), np.array(accel, dtype=np.float64)))
        self._advance()

    def add_drive(self, sample: DriveSample) -> None:
        self._sequencer.add_drive(sample)

    def add_depth(self, frame: DepthFrame) -> None:
        self._depth.add(frame)

    def add_frame(self, frame: ImageFrame) -> None:
        self._sequencer.add_frame(frame)
        self._advance()

    def catch_up(self) -> bool:
        return self._backend is not None and (self._backend.catch_up() or self._describe_next(self._backend))

    def _describe_next(self, backend: SlamBackend) -> bool:
        """Describe a keyframe for localisation, which needs all of them as soon as there is a map."""
        pictures = backend.keyframe_pictures()
        if len(pictures) < self._num_described:  # the backend left some out
            self._num_described = 0
            self._pictures.keep_only(pictures)
        if self._num_described == len(pictures):
            return False
        self._num_described += 1
        features = backend.keyframe_features(self._num_described - 1)
        if features is not None:
            return True  # stored at the end, with all others
        try:
            self._pictures.describe(pictures[self._num_described - 1])
        except Exception:  # whoever needs it describes it again; the pictures after it are described all the same
            logger.exception("a picture could not be described")
        return True

    def described_pictures(self) -> DescribedPictures:
        """Keyframes that are described by now: while they waited, and by the backend while it made the map."""
        if self._backend is not None:
            for number, picture in enumerate(self._backend.keyframe_pictures()):
                features = self._backend.keyframe_features(number)
                if features is not None:
                    self._pictures.store(picture, features)
        return self._pictures

    def finish(self, navigation_id: str, folder: Path) -> NavigationReport:
        navigation = self.complete(navigation_id)
        save_navigation(navigation, folder)
        self.described_pictures().keep_only(navigation.keyframes.encoded)
        try:
            self._pictures.write(folder / PICTURES)
        except OSError as exc:  # whoever needs them describes them again
            logger.warning("%s cannot be written (%s)", folder / PICTURES, exc)
        return navigation.report

    def complete(self, navigation_id: str) -> Navigation:
        """End the navigation. Raises EstimationError with the reason when nothing came out."""
        for item in self._sequencer.rest():
            self._feed(item)
        if self._backend is None:
            raise EstimationError("the navigation ended before it began; record again")
        navigation = replace(with_depth(self._backend.finish(), self._depth), id=navigation_id)
        wall_s, cpu_s = time.monotonic() - self._started_s, time.process_time()
        factor = navigation.report.duration_s / wall_s
        report = replace(navigation.report, wall_s=wall_s, cpu_s=cpu_s, realtime_factor=factor)
        return replace(navigation, report=report)

    def _advance(self) -> None:
        for item in self._sequencer.ready():
            self._feed(item)

    def _feed(self, item: ImuBatch | DriveSample | ImageFrame) -> None:
        if self._backend is None:
            return
        if isinstance(item, ImuBatch):
            self._backend.add_imu(item)
        elif isinstance(item, DriveSample):
            self._backend.add_drive(item)
        else:
            self._emit(self._backend.add_frame(item))
