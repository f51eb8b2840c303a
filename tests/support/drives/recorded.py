"""What is stored of a world: its map, and drives through it as the robot sent them, with the truth beside."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

from shared.calibration import Calibration
from shared.geometry import FloatArray, carry_poses, inverse_sim3
from station.model.calibration_fit import CalibrationFit
from station.model.frames import DriveSample, ImuBatch
from station.model.navigation import Trajectory
from station.model.place_map import PlaceMap
from station.places.localisation.localizer import Attempt
from station.places.localisation.tried_pictures import TriedPicture


@dataclass(frozen=True, slots=True, eq=False)
class SlamPose:
    """A pose of a running SLAM."""

    t_robot_ns: int
    T_nav_body: FloatArray  # (4, 4)
    segment: int


@dataclass(frozen=True, slots=True)
class SlamFit:
    """What a running SLAM says of the calibration; when it says something else than before."""

    t_robot_ns: int
    fit: CalibrationFit


@dataclass(frozen=True, slots=True, eq=False)
class LookedAt:
    """An image that was looked for in the map, and where it was taken in truth. Truth is for judging only."""

    t_robot_ns: int  # the camera's clock, as sent
    attempt: Attempt  # the real localiser's
    T_map_body: FloatArray | None  # (4, 4) by the alignment of the map to the truth; None: the map does not hold it
    beyond_m: float  # from the door of the room left out, when in it; 0 in a mapped room
    is_carried: bool  # in a hand
    T_map_twin: FloatArray | None = None  # (4, 4) the same spot of the twin of the room it is in; None: it has none


Event = ImuBatch | DriveSample | SlamPose | SlamFit | LookedAt


@dataclass(frozen=True, slots=True)
class TrueHijack:
    """Times are the IMU's."""

    grabbed_ns: int
    put_down_ns: int
    to_unmapped: bool


@dataclass(frozen=True, slots=True, eq=False)
class RecordedDrive:
    """One drive, in the order in which the robot sent it."""

    name: str
    calibration: Calibration  # as told
    events: tuple[Event, ...]
    hijack: TrueHijack | None
    seconds: float

    @property
    def images(self) -> Iterator[LookedAt]:
        return (e for e in self.events if isinstance(e, LookedAt))


@dataclass(frozen=True, slots=True, eq=False)
class MapQuality:
    """The mapping navigation beside the truth."""

    T_world_map: FloatArray  # (4, 4) the similarity that fits its trajectory best
    scale: float  # true length per length of the map; 1 for a perfect metric map
    error_m: float  # RMS of positions after that (ATE)
    lost_s: float


@dataclass(frozen=True, slots=True, eq=False)
class RecordedWorld:
    """One file of the cache."""

    kind: str
    name: str  # the seed, or which recordings
    misfit: str
    left_out: str  # the room that is not in the map; "" where there is none
    place_map: PlaceMap | None  # None: SLAM made none
    failure: str  # why
    quality: MapQuality | None
    truth: Trajectory | None  # of the mapping drive
    drives: tuple[RecordedDrive, ...]
    cpu_s: dict[str, float] = field(default_factory=dict)  # what making it cost
    is_mapped_both_ways: bool = True  # whoever mapped a simulated home went both ways round every room
    has_identical_twins: bool = False  # nothing within twin rooms tells them apart
    tried: tuple[TriedPicture, ...] = ()  # the map's own pictures


def generator_of(kind: str) -> str:
    """What made a kind of world: kinds of one generator look alike, and count as one where one is left out."""
    return kind if kind in ("plain", "real") else "flats"


def in_map(T_world_map: FloatArray, T_world_body: FloatArray) -> FloatArray:
    """A true pose (4, 4) in the map's frame; `T_world_map` is a similarity."""
    return carry_poses(inverse_sim3(T_world_map), T_world_body[None])[0]
