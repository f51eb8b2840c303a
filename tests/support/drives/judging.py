"""What the answers about the current place are worth: every "known" counts, wherever and whenever it is said.

- *Known* is right when the place is nearest to the true position in the map's frame, ties within 10 %; in the room that
  was left out of the map every known answer is wrong.
- *Doorway*: up to 0.3 m behind a door of that room, the robot may count as still in the room it comes from. A known
  answer with a wrong place is wrong there too; all others are left out, and counted as left out.
- *Recall*: of the answers in mapped rooms, the share that is known and right. In a hand the robot is in no room: such
  answers are no part of it, but a known one is judged as any other.
- *After a hijack*: from when the robot is put down in a mapped room to the first known and right answer.
- *False alarm*: a hijack event outside of the time from the grip to 10 s after the robot was put down.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from shared.geometry import FloatArray
from station.demo.judge import TIE
from station.experiments.calibration_curve import calibration_bins, calibration_error, wilson_interval
from station.model.place_answer import HijackEvent
from station.model.place_map import PlaceMap
from tests.support.drives.playback import Played
from tests.support.drives.recorded import LookedAt, RecordedDrive, TrueHijack

DOORWAY_M = 0.3
RECOVERED_S = 10.0  # asked, and for so long cues of the hijack may come
Where = Literal["mapped", "doorway", "unmapped", "hand"]


@dataclass(frozen=True, slots=True)
class JudgedAnswer:
    t_robot_ns: int  # the camera's clock
    state: str
    where: Where
    is_right: bool  # of a known one, and of others false
    probability: float  # of the answered place, 0 where none is

    @property
    def is_known(self) -> bool:
        return self.state == "known"

    @property
    def is_left_out(self) -> bool:
        """In a doorway both "here" and "unknown" are right."""
        return self.where == "doorway" and (self.is_right or not self.is_known)


@dataclass(frozen=True, slots=True)
class JudgedDrive:
    name: str
    answers: tuple[JudgedAnswer, ...]
    hijack: TrueHijack | None
    found_again_s: float | None  # after being put down in a mapped room; None: never, or no such hijack
    noticed_s: float | None  # after the grip
    false_alarms: int
    undisturbed_s: float


def right_places(place_map: PlaceMap, p_map: FloatArray) -> set[str]:
    """Ids of the places nearest to a position (3,), ties within 10 %."""
    if not place_map.places:
        return set()
    distance = np.linalg.norm([p.centroid_map - p_map for p in place_map.places], axis=1)
    return {place_map.places[i].id for i in np.flatnonzero(distance <= TIE * distance.min())}


def where_taken(image: LookedAt) -> Where:
    """What is asked of an answer to this image."""
    if image.T_map_body is None or image.beyond_m > DOORWAY_M:
        return "unmapped"
    if image.is_carried:
        return "hand"
    return "doorway" if image.beyond_m > 0 else "mapped"


def judge_drive(place_map: PlaceMap, drive: RecordedDrive, played: Played) -> JudgedDrive:
    """All answers of one drive beside the truth."""
    answers = []
    for image, answer in played.answers:
        where, place = where_taken(image), answer.place if answer.state == "known" else None
        is_right = (
            place is not None
            and image.T_map_body is not None
            and where != "unmapped"
            and place.id in right_places(place_map, image.T_map_body[:3, 3])
        )
        probability = place.probability if place else 0.0
        answers.append(JudgedAnswer(image.t_robot_ns, answer.state, where, is_right, probability))
    alarms, noticed_s = _alarms(drive.hijack, played.hijacks)
    disturbed_s = 0.0
    if drive.hijack is not None:
        disturbed_s = (drive.hijack.put_down_ns - drive.hijack.grabbed_ns) / 1e9 + RECOVERED_S
    found_again_s = _found_again_s(answers, drive)
    undisturbed_s = max(0.0, drive.seconds - disturbed_s)
    return JudgedDrive(drive.name, tuple(answers), drive.hijack, found_again_s, noticed_s, alarms, undisturbed_s)


def _found_again_s(answers: Sequence[JudgedAnswer], drive: RecordedDrive) -> float | None:
    if drive.hijack is None or drive.hijack.to_unmapped:
        return None
    camera = drive.calibration.camera
    shift_ns = round(1e9 * camera.time_shift_s) if camera else 0
    since = [(a.t_robot_ns + shift_ns - drive.hijack.put_down_ns) / 1e9 for a in answers if a.is_right]
    return min((s for s in since if s >= 0), default=None)


def _alarms(hijack: TrueHijack | None, events: Iterable[HijackEvent]) -> tuple[int, float | None]:
    """How many were false, and after how many seconds the true one was noticed."""
    if hijack is None:
        return len(list(events)), None
    until_ns = hijack.put_down_ns + round(1e9 * RECOVERED_S)
    is_true = [(hijack.grabbed_ns <= e.t_robot_ns <= until_ns, e.t_robot_ns) for e in events]
    since = [(t - hijack.grabbed_ns) / 1e9 for true, t in is_true if true]
    return sum(not true for true, _ in is_true), min(since, default=None)


@dataclass(frozen=True, slots=True)
class Share:
    """So many of so many."""

    count: int
    of: int

    @property
    def value(self) -> float | None:
        return self.count / self.of if self.of else None

    @property
    def interval(self) -> tuple[float, float]:
        return wilson_interval(self.count, self.of)

    def __str__(self) -> str:
        if self.value is None:
            return "none"
        low, high = self.interval
        return f"{self.value:.1%} ({self.count} of {self.of}; {low:.1%}-{high:.1%})"


@dataclass(frozen=True, slots=True)
class Summary:
    """What is asked of the current place, over some drives."""

    precision: Share  # of all known answers: right
    recall: Share  # of the answers in mapped rooms: known and right
    silent: Share  # of the answers in a room no map knows: not known
    calibration_error: float
    found_again: Share  # of the hijacks to mapped rooms: known and right within 10 s of being put down
    noticed: Share  # of the hijacks: within 2 s of the grip
    false_alarms: int
    undisturbed_h: float
    left_out: Share  # of all answers: in a doorway, and right either way

    @property
    def false_alarms_per_hour(self) -> float | None:
        return self.false_alarms / self.undisturbed_h if self.undisturbed_h else None


NOTICED_S = 2.0


def summarise(drives: Sequence[JudgedDrive]) -> Summary:
    """Over all answers of all drives."""
    answers = [a for d in drives for a in d.answers]
    counted = [a for a in answers if not a.is_left_out]
    known = [a for a in counted if a.is_known]
    mapped = [a for a in counted if a.where == "mapped"]
    unmapped = [a for a in counted if a.where == "unmapped"]
    hijacks = [d for d in drives if d.hijack is not None]
    to_mapped = [d.found_again_s for d in hijacks if d.hijack is not None and not d.hijack.to_unmapped]
    return Summary(
        precision=Share(sum(a.is_right for a in known), len(known)),
        recall=Share(sum(a.is_right for a in mapped), len(mapped)),
        silent=Share(sum(not a.is_known for a in unmapped), len(unmapped)),
        calibration_error=calibration_error(calibration_bins((a.probability, a.is_right) for a in known)),
        found_again=Share(sum(s is not None and s <= RECOVERED_S for s in to_mapped), len(to_mapped)),
        noticed=Share(sum(d.noticed_s is not None and d.noticed_s <= NOTICED_S for d in hijacks), len(hijacks)),
        false_alarms=sum(d.false_alarms for d in drives),
        undisturbed_h=sum(d.undisturbed_s for d in drives) / 3600,
        left_out=Share(len(answers) - len(counted), len(answers)),
    )
