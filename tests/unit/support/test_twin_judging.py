"""What is said in one of two twin rooms beside the truth: right, a guess, or one of two."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from shared.calibration import Calibration
from shared.geometry import se3
from station.model.place_answer import PlaceAnswer, RoomCandidate
from station.places.localisation.localizer import Attempt
from tests.support.drives.judging import Share
from tests.support.drives.playback import Played
from tests.support.drives.recorded import LookedAt, RecordedDrive, TrueHijack
from tests.support.drives.twin_judging import TwinDrive, judge_twins, summarise_twins
from tests.support.places import make_map
from tests.support.plans import with_two_rooms

S = 1_000_000_000
HERE_X, THERE_X = 1.0, 5.0  # in room-l and room-k


def image_at(seconds: float, *, in_twin: bool = True) -> LookedAt:
    here, there = (se3(np.eye(3), np.array([x, 0.0, 0.0])) for x in (HERE_X, THERE_X))
    attempt = Attempt(None, (), "", 0, 0, 0.0)
    return LookedAt(round(seconds * S), attempt, here, 0.0, False, there if in_twin else None)


def answer(room: RoomCandidate | None = None, two: Sequence[RoomCandidate] = ()) -> PlaceAnswer:
    return PlaceAnswer("lost", None, None, None, 0, None, None, 0, (), "", room=room, one_of_two=tuple(two))


def candidate(room_id: str, probability: float) -> RoomCandidate:
    return RoomCandidate(room_id, room_id, probability)


RIGHT, GUESS = answer(candidate("room-l", 0.9)), answer(candidate("room-k", 0.85))
ONE_OF_TWO = answer(None, [candidate("room-k", 0.5), candidate("room-l", 0.45)])
OPEN = answer()


def judged(answers: Sequence[tuple[LookedAt, PlaceAnswer]], hijack: TrueHijack | None) -> TwinDrive:
    drive = RecordedDrive("drive", Calibration(camera=None, imu=None), tuple(i for i, _ in answers), hijack, 60.0)
    return judge_twins(with_two_rooms(make_map()), drive, Played(tuple(answers), ()))


PUT_DOWN = TrueHijack(8 * S, 10 * S, to_unmapped=False)


def test_answers_count_from_being_put_down_until_the_room_is_left() -> None:
    answers = [
        (image_at(9.0), GUESS),
        (image_at(10.5), OPEN),
        (image_at(11.0), ONE_OF_TWO),
        (image_at(12.0), GUESS),
        (image_at(13.0), RIGHT),
        (image_at(14.0, in_twin=False), GUESS),
        (image_at(15.0), GUESS),
    ]
    drive = judged(answers, PUT_DOWN)
    assert [a.said for a in drive.answers] == ["nothing", "one of two", "guess", "right"]
    assert [a.since_s for a in drive.answers] == [0.5, 1.0, 2.0, 3.0]
    summary = summarise_twins([drive])
    assert summary.guessed == summary.right == summary.one_of_two == Share(1, 4)
    assert summary.first_wrong == Share(1, 1)


def test_without_a_hijack_nothing_counts() -> None:
    assert judged([(image_at(11.0), GUESS)], None).answers == ()
