"""Makes the recorded drives of one simulated flat: a map by SLAM without one room, then drives that are localised.

Of a flat with twin rooms the map may have all rooms; the robot is then put down in either twin.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace

import msgspec

from robot.simulation.atlas import default_cache_dir
from robot.simulation.config import SimulationConfig
from robot.simulation.construction import built_camera
from robot.simulation.recording import simulated_calibration
from robot.simulation.renderer import Renderer
from robot.simulation.world import World
from robot.simulation.worlds import make_world
from shared.calibration import Calibration
from shared.errors import EstimationError
from shared.geometry import FloatArray, se3
from station.experiments.alignment import align_points
from station.model.calibration_fit import CalibrationFit
from station.model.frames import DriveSample, ImageFrame, ImuBatch
from station.model.navigation import Navigation, Trajectory
from station.model.place_map import PlaceMap
from station.model.slam_update import SlamUpdate
from station.motion.interpolation import interpolate_poses
from station.places.localisation.described_pictures import DescribedPictures
from station.places.localisation.localizer import Localizer
from station.places.localisation.make_index import make_index
from station.places.making.build import build_map
from station.workers.slam import NavigationSlam
from tests.support.drives.misfit import Misfit
from tests.support.drives.recorded import (
    Event,
    LookedAt,
    MapQuality,
    RecordedDrive,
    RecordedWorld,
    SlamFit,
    SlamPose,
    in_map,
)
from tests.support.drives.robot import Sent, SimulatedRobot
from tests.support.drives.routes import (
    PLANS,
    TWIN_PLANS,
    Plan,
    beyond_door_m,
    mapping_route,
    plan_drive,
    plan_twin_drive,
    room_left_out,
    spot_in_twin,
)

MAX_MAPPING_S = 480.0  # both ways round seven rooms takes five minutes


@dataclass(frozen=True, slots=True)
class DriveOptions:
    """How much is made of each world."""

    mapping_rate_hz: float = 15.0  # frames a second that SLAM is given
    image_rate_hz: float = 3.0  # ... and that are looked for in the map
    plans: tuple[str, ...] = PLANS
    with_slam: bool = False  # a navigation is recorded meanwhile: SLAM gives odometry and a fit; needs all its frames
    max_seconds: float = MAX_MAPPING_S  # of the mapping drive
    both_ways: bool = True  # the driver who maps goes both ways round every room, as the page asks
    maps_all: bool = False  # no room is left out; drives are `TWIN_PLANS` then
    identical_twins: bool = False  # nothing within twin rooms tells them apart


def make_drives(kind: str, seed: int, misfit: Misfit, options: DriveOptions) -> RecordedWorld:
    """The world of this kind and seed, mapped and driven through."""
    spent = Spent()
    with spent.on("world"):
        flat = SimulatedFlat(kind, seed, misfit, options)
        left_out = "" if options.maps_all else room_left_out(flat.world)
        plans = [  # before mapping, which takes minutes: not every world has twins
            plan_twin_drive(flat.world, name, seed + number)
            if options.maps_all
            else plan_drive(flat.world, left_out, name, seed + number)
            for number, name in enumerate(TWIN_PLANS if options.maps_all else options.plans)
        ]
    empty = RecordedWorld(
        kind,
        str(seed),
        misfit.name,
        left_out,
        None,
        "",
        None,
        None,
        (),
        spent.cpu_s,
        options.both_ways,
        options.identical_twins,
    )
    with spent.on("mapping"):
        try:
            mapped = flat.mapped(left_out)
        except EstimationError as exc:
            return replace(empty, failure=str(exc))
    with spent.on("index"):
        index = make_index(mapped.place_map, pictures=mapped.pictures)
        localizer = Localizer([mapped.place_map], index=[index])
    drives = []
    for number, plan in enumerate(plans):
        with spent.on(plan.name):
            drives.append(flat.drive(plan, seed + 1 + number, localizer, mapped.quality.T_world_map, left_out))
    return replace(
        empty,
        place_map=mapped.place_map,
        quality=mapped.quality,
        truth=mapped.truth,
        drives=tuple(drives),
        tried=index.tried,
    )


@dataclass(frozen=True, slots=True, eq=False)
class MappedFlat:
    place_map: PlaceMap
    quality: MapQuality
    truth: Trajectory  # of the mapping drive
    pictures: DescribedPictures  # of the map, by SLAM


class SimulatedFlat:
    """A world with the robot that drives in it."""

    def __init__(self, kind: str, seed: int, misfit: Misfit, options: DriveOptions) -> None:
        asked = SimulationConfig(camera_rate_hz=options.mapping_rate_hz, identical_twins=options.identical_twins)
        config = misfit.built(asked)
        self.told = simulated_calibration(config)
        assert self.told.camera is not None
        camera = built_camera(self.told.camera, config.build)
        self._built = msgspec.structs.replace(self.told, camera=camera)
        self.shift_ns = round(1e9 * camera.time_shift_s)  # true, from the camera's clock to the IMU's
        self._config, self._options = config, options
        self.world: World = make_world(kind, seed, config)
        self._renderer = Renderer(self.world, camera, default_cache_dir())

    def robot(self, plan: Plan, seed: int) -> SimulatedRobot:
        return SimulatedRobot(self._renderer, self._built, self._config, plan, seed)

    def mapped(self, left_out: str = "") -> MappedFlat:
        """Drive through all rooms but one, and map them with the `ukf` backend. Raises EstimationError if it cannot."""
        seed, name = self.world.seed, f"{self.world.name}-{self.world.seed}"
        route = mapping_route(self.world, left_out, seed, self._options.both_ways)
        robot = self.robot(Plan("mapping", route, None, self._options.max_seconds), seed)
        slam = RunningSlam(self.told, seed)
        for item in robot.sent(self._options.mapping_rate_hz):
            slam.add(item)
        navigation = slam.complete(name)
        quality = compare(navigation, robot.truth)
        return MappedFlat(build_map(navigation), quality, robot.truth, slam.described_pictures())

    def drive(
        self, plan: Plan, seed: int, localizer: Localizer, T_world_map: FloatArray, left_out: str
    ) -> RecordedDrive:
        """One drive, every image of it looked for in the map."""
        robot, options = self.robot(plan, seed), self._options
        slam = RunningSlam(self.told, seed) if options.with_slam else None
        every = max(1, round(options.mapping_rate_hz / options.image_rate_hz)) if slam else 1
        events: list[Event] = []
        for item in robot.sent(options.mapping_rate_hz if slam else options.image_rate_hz):
            if slam is not None:
                events += slam.told_after(item)
            if not isinstance(item, ImageFrame):
                events.append(item)
            elif item.index % every == 0:
                T, is_carried = robot.true_at(item.t_robot_ns + self.shift_ns)
                beyond_m = beyond_door_m(self.world, left_out, T[:3, 3])
                attempt = localizer.attempt(item, self.told, slam.fit if slam else None)
                T_map_body = in_map(T_world_map, T)
                T_map_twin = self._in_twin(T, T_world_map)
                events.append(LookedAt(item.t_robot_ns, attempt, T_map_body, beyond_m, is_carried, T_map_twin))
        seconds = (robot.truth.t_robot_ns[-1] - robot.truth.t_robot_ns[0]) / 1e9
        return RecordedDrive(plan.name, self.told, tuple(events), robot.hijack, float(seconds))

    def _in_twin(self, T_world_body: FloatArray, T_world_map: FloatArray) -> FloatArray | None:
        """T_map_body (4, 4) of a robot at the same spot of its room's twin."""
        spot = spot_in_twin(self.world, T_world_body[:3, 3])
        return None if spot is None else in_map(T_world_map, se3(T_world_body[:3, :3], spot))


class RunningSlam:
    """The SLAM worker's part of a live drive."""

    def __init__(self, told: Calibration, seed: int, backend: str = "ukf") -> None:
        self._updates: list[SlamUpdate] = []
        self._slam = NavigationSlam(self._updates.append)
        self._slam.begin(backend, told, seed, 1, True)
        self.fit: CalibrationFit | None = None

    def add(self, item: Sent) -> None:
        if isinstance(item, ImuBatch):
            self._slam.add_imu(item.t_robot_ns.tolist(), item.gyro_imu.tolist(), item.accel_imu.tolist())
        elif isinstance(item, DriveSample):
            self._slam.add_drive(item)
        else:
            self._slam.add_frame(item)

    def told_after(self, item: Sent) -> Sequence[SlamPose | SlamFit]:
        """What it says on receiving this."""
        self.add(item)
        told: list[SlamPose | SlamFit] = []
        for update in self._updates:
            if update.T_world_body is not None:
                told.append(SlamPose(update.t_robot_ns, update.T_world_body, update.segment))
            if update.calibration_fit is not None and update.calibration_fit != self.fit:
                self.fit = update.calibration_fit
                told.append(SlamFit(update.t_robot_ns, self.fit))
        self._updates.clear()
        return told

    def complete(self, navigation_id: str) -> Navigation:
        """Raises EstimationError, with the reason, when nothing came out."""
        return self._slam.complete(navigation_id)

    def described_pictures(self) -> DescribedPictures:
        return self._slam.described_pictures()


def compare(navigation: Navigation, truth: Trajectory) -> MapQuality:
    """The mapping navigation aligned to the truth by a similarity."""
    T_true, kept = interpolate_poses(truth, navigation.trajectory.t_robot_ns)
    mapped = navigation.trajectory.T_world_body[kept]
    aligned = align_points(T_true[:, :3, 3], mapped[:, :3, 3], "sim3")
    return MapQuality(aligned.T_target_source, aligned.scale, aligned.rms, navigation.report.tracking_lost_s)


@dataclass
class Spent:
    """CPU seconds of this process by what they went into."""

    cpu_s: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def on(self, what: str) -> Iterator[None]:
        begin = time.process_time()
        try:
            yield
        finally:
            self.cpu_s[what] = round(time.process_time() - begin, 1)
