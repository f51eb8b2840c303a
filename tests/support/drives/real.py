"""Recorded drives from real recordings: hand-held and flown, mapped by SLAM from their images.

Only `v102` has images that are not real: V1_02's come without any, so a hall is rendered along its true path, and its
real IMU goes with them.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from robot.simulation.along import render_along
from robot.simulation.atlas import default_cache_dir
from robot.simulation.config import SimulationConfig
from robot.simulation.worlds import make_world
from shared.errors import EstimationError
from shared.geometry import FloatArray
from station.datasets import Dataset, Truth, open_dataset
from station.model.frames import DepthFrame, DriveSample, ImuBatch
from station.model.navigation import Trajectory
from station.motion.interpolation import interpolate_poses
from station.places.localisation.localizer import Localizer
from station.places.localisation.make_index import make_index
from station.places.making.build import build_map
from station.workers.replay import ReplayOptions, follow, has_live_poses, live_backend
from tests.support.drives.recorded import Event, LookedAt, RecordedDrive, RecordedWorld, in_map
from tests.support.drives.simulated import RunningSlam, Spent, compare
from tests.support.paths import RECORDINGS

KIND = "real"
LIVE_RATE_HZ = 4.0  # images looked for, as the live system does (localization.rate_hz)


@dataclass(frozen=True, slots=True)
class Part:
    """Some of a recording."""

    folder: str  # in RECORDINGS, or RENDERED
    first: int | None = None
    last: int | None = None
    every_image: bool = False  # instead of LIVE_RATE_HZ


RENDERED = "v102 rendered"
KITCHEN, KEYFRAMES = "redkitchen", "euroc_v1_01_keyframes"
FLIGHT, STATIC, V102 = "euroc_v1_01_flight", "euroc_v1_01_static", "euroc_v1_02_imu"


@dataclass(frozen=True, slots=True)
class Case:
    """A map, and what is looked for in it."""

    map_of: Part
    backend: str
    queries: tuple[Part, ...]
    is_same_building: bool = True


KITCHEN_1, KITCHEN_2 = Part(KITCHEN, 0, 398), Part(KITCHEN, 500, 698)
HALF_1, HALF_2 = Part(KEYFRAMES, 0, 24), Part(KEYFRAMES, 25, 49)
V102_1, V102_2 = Part(RENDERED, 0, 399), Part(RENDERED, 400, 799)
EVERY_KITCHEN = Part(KITCHEN, every_image=True)
EVERY_V101 = tuple(Part(folder, every_image=True) for folder in (KEYFRAMES, FLIGHT, STATIC))
EVERY_V102 = Part(RENDERED, every_image=True)
CASES = {
    "kitchen": Case(KITCHEN_1, "sfm", (KITCHEN_2,)),
    "kitchen_back": Case(KITCHEN_2, "sfm", (KITCHEN_1,)),
    "v101_halves": Case(HALF_1, "sfm", (HALF_2,)),
    "v101_halves_back": Case(HALF_2, "sfm", (HALF_1,)),
    "v101_flight": Case(Part(KEYFRAMES), "sfm", (Part(FLIGHT), Part(STATIC))),
    "v102": Case(V102_1, "ukf", (V102_2,)),
    "v102_back": Case(V102_2, "ukf", (V102_1,)),
    "elsewhere_kitchen": Case(KITCHEN_1, "sfm", (*EVERY_V101, EVERY_V102), is_same_building=False),
    "elsewhere_v101": Case(Part(KEYFRAMES), "sfm", (EVERY_KITCHEN, EVERY_V102), is_same_building=False),
}


def make_real(name: str) -> RecordedWorld:
    """One case. Raises DataError where the recordings are not there."""
    case, spent = CASES[name], Spent()
    with _opened(case) as open_part:
        data = open_part(case.map_of)
        truth = _trajectory(data.truth)
        with spent.on("mapping"):
            try:
                navigation, _ = follow(data, ReplayOptions(backend=case.backend))
                place_map = build_map(navigation)
            except EstimationError as exc:
                return RecordedWorld(KIND, name, "", "", None, str(exc), None, truth, (), spent.cpu_s)
            quality = compare(navigation, truth)
        with spent.on("index"):
            index = make_index(place_map)
            localizer = Localizer([place_map], index=[index])
        drives = []
        for part in case.queries:
            with spent.on(part.folder):
                T_world_map = quality.T_world_map if case.is_same_building else None
                drives.append(_drive(open_part(part), part, localizer, T_world_map))
    left_out = "" if case.is_same_building else "everywhere"
    return RecordedWorld(
        KIND, name, "", left_out, place_map, "", quality, truth, tuple(drives), spent.cpu_s, tried=index.tried
    )


def _drive(data: Dataset, part: Part, localizer: Localizer, T_world_map: FloatArray | None) -> RecordedDrive:
    """With the live SLAM's poses where there are any; images whose true place in the map is not known are left out."""
    camera = data.calibration.camera
    shift_ns = round(1e9 * camera.time_shift_s) if camera else 0
    times = data.frame_times_ns + shift_ns
    T_true, kept = interpolate_poses(_trajectory(data.truth), times)
    T_world_body = {int(times[k]): T for k, T in zip(kept, T_true, strict=True)}
    period_ns = 0 if part.every_image else round(1e9 / LIVE_RATE_HZ)
    next_ns = int(times[0])
    slam = RunningSlam(data.calibration, 1, live_backend(data, "auto")) if has_live_poses(data, "auto") else None
    events: list[Event] = []
    for item in data.events():
        if isinstance(item, DepthFrame):
            continue
        told = slam.told_after(item) if slam else []
        if isinstance(item, ImuBatch | DriveSample):
            events += [item, *told]
            continue
        events += told
        t_ns = item.t_robot_ns + shift_ns
        if t_ns < next_ns or (T_world_map is not None and t_ns not in T_world_body):
            continue
        next_ns = t_ns + period_ns
        T_map_body = None if T_world_map is None else in_map(T_world_map, T_world_body[t_ns])
        events.append(
            LookedAt(
                item.t_robot_ns,
                localizer.attempt(item, data.calibration, slam.fit if slam else None),
                T_map_body,
                0.0,
                False,
            )
        )
    seconds = float(times[-1] - times[0]) / 1e9
    return RecordedDrive(part.folder, data.calibration, tuple(events), None, seconds)


def _trajectory(truth: Truth | None) -> Trajectory:
    if truth is None:
        return Trajectory(np.zeros(0, np.int64), np.zeros((0, 4, 4)))
    return Trajectory(truth.t_robot_ns, truth.T_world_body)


@contextmanager
def _opened(case: Case) -> Iterator[Callable[[Part], Dataset]]:
    """Gives the parts of a case; what is rendered for it goes when it ends."""
    with tempfile.TemporaryDirectory(prefix="rendered-") as folder:
        rendered = Path(folder) / "v102"
        if RENDERED in {part.folder for part in (case.map_of, *case.queries)}:
            _render_v102(rendered)

        def open_part(part: Part) -> Dataset:
            path = rendered if part.folder == RENDERED else RECORDINGS / part.folder
            return open_dataset(path, part.first, part.last)

        yield open_part


def _render_v102(out: Path) -> None:
    recording = RECORDINGS / V102 / "mav0"
    render_along(
        make_world("vicon", 0),
        recording / "state_groundtruth_estimate0" / "data.csv",
        recording / "cam0" / "sensor.yaml",
        recording / "imu0",
        out,
        SimulationConfig(),
        seed=0,
        cache_dir=default_cache_dir(),
    )
