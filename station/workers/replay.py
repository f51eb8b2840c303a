"""A recorded navigation through the code of the live workers, in recorded time: the same input gives the same bits.

What could differ between two runs is held: linear algebra runs on one thread (how sums are split changes their last
bits), COLMAP's mapper too, and pictures are looked for in the map at fixed times of the recording instead of whenever a
worker is free.
"""

from __future__ import annotations

import hashlib
import json
import logging
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass, replace

import numpy as np

from shared.errors import ConfigError, DataError
from station.config import AUTO, can_filter, choose_backend
from station.datasets import Dataset
from station.maps.record import map_content_hash
from station.model.calibration_fit import CalibrationFit, newer
from station.model.frames import DepthFrame, DriveSample, ImageFrame, ImuBatch
from station.model.navigation import Navigation, Trajectory
from station.model.place_answer import HijackEvent, HijackNotice, PlaceAnswer
from station.model.place_map import PlaceMap
from station.model.slam_update import SlamUpdate
from station.places.localisation.described_pictures import DescribedPictures
from station.places.localisation.make_index import make_index
from station.places.making.build import build_map
from station.workers.place_interface import PlaceEvent
from station.workers.places import PlaceFinder
from station.workers.repeatable import repeatable
from station.workers.slam import NavigationSlam

logger = logging.getLogger(__name__)

STAMP_ROUNDING_NS = 1_000_000  # stamps of a constant rate jitter by less: as many pictures a second as asked for
MIN_FILM_HZ = 5.0  # slower pictures are no film: the filter's corners are followed from one to the next
Pace = Callable[[int], None]  # given the recorded time before something of it is used; may wait
Say = Callable[[str], None]  # given what is done next


@dataclass(frozen=True, slots=True)
class ReplayOptions:
    backend: str = "sfm"
    seed: int = 1
    threads: int = 1  # of image processing; any number gives the same result
    rate_hz: float = 4.0  # pictures a second that are looked for in the map (config: localization.rate_hz)

    def __post_init__(self) -> None:
        if self.threads < 1:
            raise ConfigError(f"threads = {self.threads} must be at least 1")
        if not 1e-3 <= self.rate_hz <= 1e3:
            raise ConfigError(f"rate = {self.rate_hz:g} must be between 0.001 and 1000 pictures a second")


@dataclass(frozen=True, slots=True, eq=False)
class Replay:
    navigation: Navigation
    place_map: PlaceMap  # made from it
    answers: tuple[PlaceAnswer, ...]  # in the map given, else in the one just made
    hijacks: tuple[HijackEvent, ...]

    def hashes(self) -> dict[str, str]:
        """SHA-256 of each part, over all its bits."""
        return {
            "trajectory": trajectory_hash(self.navigation.trajectory),
            "map": map_content_hash(self.place_map),
            "answers": answers_hash(self.answers),
        }


def replay(
    data: Dataset,
    options: ReplayOptions,
    known_map: PlaceMap | None = None,
    pace: Pace = lambda _: None,
    say: Say = lambda _: None,
) -> Replay:
    """Run SLAM over a recorded navigation, make its map, and ask at every moment which place the robot is at.

    Raises:
        EstimationError: nothing could be reconstructed; says why.
        DataError: the recording has no images, or one that cannot be read.
    """
    with repeatable(options.threads):
        slam, updates = run_slam(data, options, pace, say)
        navigation = _complete(slam, data, say)
        say("clustering landmarks into places")
        place_map = build_map(navigation)
        say("looking at the pictures of the map")
        pictures = slam.described_pictures() if known_map is None else None
        answers, hijacks = locate(data, known_map or place_map, updates, options, pace, say, pictures)
    return Replay(navigation, place_map, answers, hijacks)


def locate_live(
    data: Dataset,
    place_map: PlaceMap,
    options: ReplayOptions,
    pace: Pace = lambda _: None,
    say: Say = lambda _: None,
) -> tuple[tuple[PlaceAnswer, ...], tuple[HijackEvent, ...]]:
    """Ask at every moment which place of a map the robot is at; no map is made of the recording.

    Raises DataError when the recording has no images, or one that cannot be read.
    """
    with repeatable(options.threads):
        beside = replace(options, backend=live_backend(data, options.backend))
        updates = run_slam(data, beside, pace, say)[1] if has_live_poses(data, options.backend) else []
        say("looking at the pictures of the map")
        return locate(data, place_map, updates, options, pace, say)


def has_live_poses(data: Dataset, backend: str) -> bool:
    """Whether SLAM would give poses in metres on the way: sfm and mono have none, and a filter needs IMU and a film."""
    if live_backend(data, backend) in ("sfm", "mono") or data.imu is None or len(data.frame_times_ns) < 2:
        return False
    return float(np.median(np.diff(data.frame_times_ns))) <= 1e9 / MIN_FILM_HZ


def live_backend(data: Dataset, backend: str) -> str:
    """What follows the robot beside the search for its place: "auto" is ukf in any hands, for its poses on the way."""
    return "ukf" if backend == AUTO and can_filter(data.calibration) else choose_backend(backend, data.calibration)


def follow(
    data: Dataset, options: ReplayOptions, pace: Pace = lambda _: None, say: Say = lambda _: None
) -> tuple[Navigation, list[SlamUpdate]]:
    """The SLAM worker's part."""
    slam, updates = run_slam(data, options, pace, say)
    return _complete(slam, data, say), updates


def _complete(slam: NavigationSlam, data: Dataset, say: Say) -> Navigation:
    say("making the navigation")
    return slam.complete(f"replay-{data.path.stem}")


def run_slam(data: Dataset, options: ReplayOptions, pace: Pace, say: Say) -> tuple[NavigationSlam, list[SlamUpdate]]:
    """SLAM over all of a recording, not completed, and what it said on the way."""
    say("following the robot")
    updates: list[SlamUpdate] = []
    slam = NavigationSlam(updates.append)
    slam.begin(options.backend, data.calibration, options.seed, 1, data.intrinsics_known)
    for event in _paced(data.events(), pace):
        if isinstance(event, ImuBatch):
            slam.add_imu(event.t_robot_ns.tolist(), event.gyro_imu.tolist(), event.accel_imu.tolist())
        elif isinstance(event, DriveSample):
            slam.add_drive(event)
        elif isinstance(event, DepthFrame):
            try:
                slam.add_depth(event)
            except DataError as exc:  # as the worker of a running robot goes on without it
                logger.warning("%s; it is left out", exc)
        else:
            slam.add_frame(event)
    return slam, updates


def locate(
    data: Dataset,
    place_map: PlaceMap,
    updates: Iterable[SlamUpdate],
    options: ReplayOptions,
    pace: Pace = lambda _: None,
    say: Say = lambda _: None,
    pictures: DescribedPictures | None = None,
) -> tuple[tuple[PlaceAnswer, ...], tuple[HijackEvent, ...]]:
    """The localisation worker's part.

    `updates`: what SLAM said on the way, poses and of the calibration; `pictures`: of the map, described already.
    """
    hijacks: list[HijackEvent] = []

    def receive(event: PlaceEvent) -> None:
        if isinstance(event, HijackNotice):
            hijacks.append(event.event)

    places = PlaceFinder(receive)
    places.use([place_map], None if pictures is None else [make_index(place_map, pictures=pictures)])
    places.calibrate(data.calibration)
    say("looking for the current place")
    following = iter(updates)
    update = next(following, None)
    interval_ns = round(1e9 / options.rate_hz)
    next_ns: int | None = None
    fit: CalibrationFit | None = None
    answers = []
    for event in _paced(data.events(), pace):
        if isinstance(event, ImuBatch):
            places.add_imu(event.t_robot_ns.tolist(), event.gyro_imu.tolist(), event.accel_imu.tolist())
        elif isinstance(event, DriveSample):
            places.add_drive(event)
        elif isinstance(event, ImageFrame) and (next_ns is None or event.t_robot_ns >= next_ns):
            next_ns = event.t_robot_ns + interval_ns - STAMP_ROUNDING_NS
            answers.append(places.answer(event).answer)
        while update is not None and update.t_robot_ns <= _begin(event):
            if update.T_world_body is not None and update.scale == "metric":
                places.add_pose(update.t_robot_ns, update.T_world_body, update.segment)
            if update.calibration_fit is not None:
                fit = newer(fit, update.calibration_fit)
                places.use_fit(fit)
            update = next(following, None)
    return tuple(answers), tuple(hijacks)


def trajectory_hash(trajectory: Trajectory) -> str:
    """SHA-256 over times and poses, every bit of them."""
    digest = hashlib.sha256(np.ascontiguousarray(trajectory.t_robot_ns, "<i8").tobytes())
    digest.update(np.ascontiguousarray(trajectory.T_world_body, "<f8").tobytes())
    return digest.hexdigest()


def answers_hash(answers: Iterable[PlaceAnswer]) -> str:
    """SHA-256 over all that the answers say; JSON writes every bit of a number."""
    return hashlib.sha256("\n".join(answer_line(answer) for answer in answers).encode()).hexdigest()


def answer_line(answer: PlaceAnswer) -> str:
    """An answer as one line of JSON."""
    plain = {name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in asdict(answer).items()}
    return json.dumps(plain)


def answer_lines(answers: Iterable[PlaceAnswer]) -> str:
    """The text of `answers.jsonl`."""
    return "".join(f"{answer_line(answer)}\n" for answer in answers)


def _paced(
    events: Iterable[ImuBatch | DriveSample | DepthFrame | ImageFrame], pace: Pace
) -> Iterator[ImuBatch | DriveSample | DepthFrame | ImageFrame]:
    for event in events:
        pace(_begin(event))
        yield event


def _begin(event: ImuBatch | DriveSample | DepthFrame | ImageFrame) -> int:
    return int(event.t_robot_ns[0]) if isinstance(event, ImuBatch) else event.t_robot_ns
