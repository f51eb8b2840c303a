"""The structure-from-motion backend: collects keyframes while the robot drives, reconstructs when it has arrived."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import asdict, replace
from typing import Any

import cv2
import msgspec
import numpy as np
import scipy

from shared.calibration import Calibration
from shared.errors import ConfigError, EstimationError
from station.files.spill import Spill, SpilledFiles
from station.model.frames import DriveSample, ImageFrame, ImuBatch
from station.model.navigation import Navigation, NavigationReport
from station.model.slam_update import SlamUpdate
from station.motion.inertial_track import concatenate_imu
from station.slam.backend import check_size
from station.slam.mapping.assemble import Reconstructed
from station.slam.mapping.odometry import dead_reckon
from station.slam.mapping.odometry_mapping import map_with_odometry, read_odometry_map
from station.slam.mapping.shortlist import Shortlist
from station.slam.mapping.tracks import Pairs
from station.slam.sfm.colmap import (
    VERSION,
    Match,
    PinholeFeatures,
    SiftExtractor,
    colmap_camera,
    map_incrementally,
    read_model,
    verify,
)
from station.slam.sfm.config import SfmConfig
from station.slam.sfm.keyframes import KeyframeSelector
from station.slam.sfm.world import place_in_world
from station.vision.features import similarities
from station.vision.lens import Lens
from station.vision.matching import match_both_ways

logger = logging.getLogger(__name__)
MIN_KEYFRAMES = 3
MAX_BATCHES = 1024  # of inertial samples, then they are joined


class SfmBackend:
    """A SlamBackend. Features and matches are made as keyframes arrive; poses and landmarks exist after finish()."""

    def __init__(
        self, calibration: Calibration, config: SfmConfig | None = None, intrinsics_known: bool = True
    ) -> None:
        if calibration.camera is None:
            raise ConfigError("structure from motion needs a camera, and the calibration has none; give one")
        self._calibration = calibration
        self._camera = calibration.camera
        self._config = config or SfmConfig()
        refine = self._config.refine_intrinsics
        self._refine = not intrinsics_known if refine is None else refine
        self._lens = Lens(self._camera)
        self._colmap_camera = colmap_camera(self._camera, refine=False)
        self._selector = KeyframeSelector(self._config.keyframes)
        self._extractor = SiftExtractor(self._config.features)
        self._shortlist = Shortlist(self._config.matching)
        self._imu: list[ImuBatch] = []
        self._drive: list[DriveSample] = []
        self._spill = Spill()
        self._frames: list[ImageFrame] = []  # keyframes, without their files
        self._encoded = SpilledFiles(self._spill)  # these
        self._features: list[PinholeFeatures] = []
        self._pairs: list[Pairs] = []  # feature pairs, unverified
        self._matches: list[Match] = []  # verified
        self._frame_times: list[int] = []

    def add_imu(self, imu: ImuBatch) -> None:
        self._imu.append(imu)
        if len(self._imu) > MAX_BATCHES:  # the heads of many small arrays take more than what is in them
            joined = concatenate_imu(self._imu)
            self._imu = self._imu if joined is None else [joined]

    def add_drive(self, drive: DriveSample) -> None:
        self._drive.append(drive)

    def add_frame(self, frame: ImageFrame) -> SlamUpdate:
        """Take one frame in. Raises DataError when the image cannot be decoded or has another size."""
        grey = frame.grey()
        check_size(frame, grey, self._camera)
        self._frame_times.append(frame.t_robot_ns)
        is_keyframe = self._selector.is_keyframe(grey, frame.t_robot_ns, self._has_odometry)
        if is_keyframe:
            self._add_keyframe(frame, self._extractor.extract(grey, self._lens))
        return SlamUpdate(
            t_robot_ns=frame.t_robot_ns,
            state="tracking" if len(self._frames) > 1 else "initialising",
            message=f"{len(self._frames)} keyframes collected; the map is made when the drive ends",
            T_world_body=None,
            num_landmarks=0,
            is_keyframe=is_keyframe,
        )

    @property
    def _has_odometry(self) -> bool:
        """Whether gyroscope and drive commands tell how the robot moves."""
        return bool(self._drive) and bool(self._imu) and self._calibration.imu is not None

    def _add_keyframe(self, frame: ImageFrame, features: PinholeFeatures) -> None:
        config = self._config.matching
        b = len(self._frames)
        previous = config.num_previous_with_odometry if self._has_odometry else config.num_previous
        older = list(range(max(0, b - previous), b))
        if not self._has_odometry:  # with odometry, loops are looked for where poses say so
            older = [*self._shortlist.most_alike(features, range(older[0] if older else 0)), *older]
            self._shortlist.add(features)
        self._frames.append(replace(frame, encoded=b""))
        self._encoded.append(frame.encoded)
        put = self._spill.put
        self._features.append(
            PinholeFeatures(put(features.uv_px), put(features.descriptors), put(features.uv_ideal_px))
        )
        for a in older:
            pairs = match_both_ways(similarities(self._features[a], features), config.max_ratio)
            self._pairs.append((a, b, put(pairs)))
            if self._calibration.imu is None:  # no odometry can come any more: do the work now
                self._verify_pairs()

    def _verify_pairs(self) -> None:
        config = self._config
        for a, b, pairs in self._pairs:
            match = verify(a, b, pairs, self._features, self._colmap_camera, config.matching, config.seed)
            if match is not None:
                self._matches.append(match)
        self._pairs.clear()

    def catch_up(self) -> bool:
        """Nothing can be done before all images are there."""
        return False

    def keyframe_pictures(self) -> Sequence[bytes]:
        return self._encoded

    def keyframe_features(self, number: int) -> None:
        """None: the features it matches are not those that localisation uses."""

    def finish(self) -> Navigation:
        """Reconstruct. Raises EstimationError, with the reason, when nothing could be reconstructed."""
        if len(self._frames) < MIN_KEYFRAMES:
            raise EstimationError(
                f"{_keyframes(len(self._frames))} too few to reconstruct from; drive further, with texture in view"
            )
        self._frames = [
            replace(frame, encoded=encoded) for frame, encoded in zip(self._frames, self._encoded, strict=True)
        ]
        imu = concatenate_imu(self._imu)
        if self._has_odometry and imu is not None:
            model, facts = self._map_with_odometry(imu)
            return self._navigation(model, imu, facts, [])
        self._verify_pairs()
        camera = colmap_camera(self._camera, self._refine)
        models = map_incrementally(camera, self._features, self._matches, self._config, self._refine)
        if not models:
            raise EstimationError(
                f"no two of {len(self._frames)} keyframes could be reconstructed; drive slower, with texture in view"
            )
        model = read_model(models[0], self._frames, self._features, self._camera, self._config, self._refine)
        left_out = len(self._frames) - len(model.keyframes)
        messages = []
        if left_out:
            messages.append(f"{left_out} of {len(self._frames)} keyframes could not be connected and were left out")
        return self._navigation(model, imu, {"mapping": "images only", "models": len(models)}, messages)

    def _map_with_odometry(self, imu: ImuBatch) -> tuple[Reconstructed, dict[str, Any]]:
        t_all = np.array([frame.t_robot_ns for frame in self._frames], dtype=np.int64)
        t_all += round(self._camera.time_shift_s * 1e9)
        covered = np.flatnonzero((t_all >= imu.t_robot_ns[0]) & (t_all <= imu.t_robot_ns[-1]))
        if len(covered) < MIN_KEYFRAMES or self._calibration.imu is None:
            raise EstimationError(
                f"inertial samples cover {len(covered)} of {len(t_all)} keyframes, too few; check the time stamps"
            )
        begin, end = int(covered[0]), int(covered[-1]) + 1
        frames, features = self._frames[begin:end], self._features[begin:end]
        pairs = [(a - begin, b - begin, p) for a, b, p in self._pairs if begin <= a and b < end]
        odometry = dead_reckon(imu, self._drive, t_all[begin:end], self._calibration.imu)
        made = map_with_odometry(features, pairs, t_all[begin:end], odometry, self._camera, self._config.mapping)
        if made.tracks.num_points == 0:
            raise EstimationError("no landmark could be triangulated; drive further, with light and texture in view")
        model = read_odometry_map(made, frames, features, self._camera, self._config.mapping)
        facts = {"mapping": "odometry and images", "loops": made.num_loops, "median_error_px": made.median_error_px}
        return model, facts

    def _navigation(
        self, model: Reconstructed, imu: ImuBatch | None, facts: dict[str, Any], messages: list[str]
    ) -> Navigation:
        placed = place_in_world(model, self._calibration, imu, self._drive, np.array(self._frame_times, dtype=np.int64))
        lost_s = tracking_lost_s(np.array(self._frame_times), model.keyframes.t_robot_ns)
        messages = [*messages, *placed.messages]
        calibration = msgspec.structs.replace(self._calibration, camera=model.camera)
        duration = (self._frame_times[-1] - self._frame_times[0]) * 1e-9
        report = NavigationReport(
            backend="sfm",
            frames=len(self._frame_times),
            duration_s=duration,
            wall_s=0.0,
            realtime_factor=0.0,
            cpu_s=0.0,
            landmarks=len(placed.landmarks),
            tracking_lost_s=lost_s,
            scale="metric" if placed.is_metric else "arbitrary",
            gravity_aligned=placed.is_gravity_aligned,
            seed=self._config.seed,
            versions={
                "pycolmap": VERSION,
                "opencv": cv2.__version__,
                "numpy": np.__version__,
                "scipy": scipy.__version__,
            },
            config=asdict(self._config) | {"refine_intrinsics": self._refine, **facts, **placed.facts},
            messages=tuple(messages),
        )
        keyframes = replace(model.keyframes, T_world_cam=placed.T_world_cam)
        identity = f"sfm-{self._frame_times[0]}"
        return Navigation(identity, calibration, placed.trajectory, keyframes, placed.landmarks, report)


def _keyframes(number: int) -> str:
    return "1 keyframe is" if number == 1 else f"{number} keyframes are"


def tracking_lost_s(t_frames_ns: np.ndarray, t_keyframes_ns: np.ndarray, max_gap_s: float = 4.0) -> float:
    """Seconds of the navigation without a keyframe near enough to know the pose."""
    marks = np.concatenate([[t_frames_ns[0]], t_keyframes_ns, [t_frames_ns[-1]]])
    gaps = np.diff(np.sort(marks)) * 1e-9
    return float(gaps[gaps > max_gap_s].sum())
