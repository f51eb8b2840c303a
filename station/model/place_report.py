"""What the localisation worker tells: its answers, with what belongs to them, and hijacks with the answer since."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from shared.geometry import FloatArray
from station.model.place_answer import PlaceAnswer

if TYPE_CHECKING:  # its module loads estimation libraries, which only the worker needs
    from station.places.tracking.hijack import HijackEvent


@dataclass(frozen=True, slots=True)
class MapReading:
    """How far the worker is with the maps that it was given."""

    fraction: float  # 0..1
    text: str


@dataclass(frozen=True, slots=True)
class MapLeftOut:
    """One of several maps that cannot be read; the robot is looked for in the others."""

    map_id: str
    reason: str


@dataclass(frozen=True, slots=True, eq=False)
class PlaceReport:
    """The current place, and how the last picture was found."""

    map_id: str  # whose frame positions are in: where the robot is, or the first map while nobody knows
    answer: PlaceAnswer
    T_map_cam: FloatArray | None  # (4, 4) of the picture the answer is about, when it was found in this map
    t_evidence_ns: int | None  # what the answer's evidence_t_robot_ns is while it rests on this picture
    attempt: str  # what speaks for the picture's pose, or why there is none, in a sentence
    num_hijacks: int = 0  # that the worker had noticed by then: an answer from before one says nothing of after it


@dataclass(frozen=True, slots=True, eq=False)
class HijackNotice:
    """The robot was picked up, and the current place since: whoever is told the one is told the other."""

    event: HijackEvent
    report: PlaceReport
