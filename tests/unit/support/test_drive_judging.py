"""Answers about the current place beside the truth: what counts as known, right, left out, found again."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from shared.calibration import Calibration
from shared.geometry import se3
from station.model.place_answer import HijackEvent, PlaceAnswer, PlaceCandidate, PlaceState
from station.model.place_map import Place, PlaceMap
from station.places.localisation.localizer import Attempt
from tests.support.drives.judging import JudgedDrive, Share, judge_drive, right_places, summarise
from tests.support.drives.playback import Played
from tests.support.drives.recorded import LookedAt, RecordedDrive, TrueHijack
from tests.support.synthetic_home import furnished_room, navigate

S = 1_000_000_000
RIG = Calibration(camera=None, imu=None)


def place_at(name: str, x: float) -> Place:
    none = np.zeros(0, dtype=np.int64)
    return Place(name, name, np.array([x, 0.0, 0.0]), 0.2, none, none, -1, 1.0)


@pytest.fixture(scope="module")
def row_of_places() -> PlaceMap:
    """Places a, b, c at x = 0, 2, 4."""
    navigation = navigate(furnished_room(1, pieces=2), np.stack([np.eye(4)] * 2), 1, images=False)
    places = tuple(place_at(name, 2.0 * k) for k, name in enumerate("abc"))
    return PlaceMap("map", "map", navigation, places, (), {})


def image_at(seconds: float, x: float, *, beyond_m: float = 0.0, is_carried: bool = False) -> LookedAt:
    pose = se3(np.eye(3), np.array([x, 0.0, 0.0]))
    return LookedAt(round(seconds * S), Attempt(None, (), "", 0, 0, 0.0), pose, beyond_m, is_carried)


def answer(state: PlaceState, place: str = "", probability: float = 0.9) -> PlaceAnswer:
    candidate = PlaceCandidate(place, place, probability) if place else None
    return PlaceAnswer(state, candidate, None, None, 0, None, None, 0, (), "")


KNOWN_A = answer("known", "a")
UNKNOWN = answer("unknown")


def judged(
    place_map: PlaceMap,
    answers: Sequence[tuple[LookedAt, PlaceAnswer]],
    hijack: TrueHijack | None = None,
    events: Sequence[HijackEvent] = (),
    seconds: float = 60.0,
) -> JudgedDrive:
    drive = RecordedDrive("drive", RIG, tuple(image for image, _ in answers), hijack, seconds)
    return judge_drive(place_map, drive, Played(tuple(answers), tuple(events)))


@pytest.mark.parametrize(("x", "right"), [(0.0, {"a"}), (0.94, {"a"}), (0.96, {"a", "b"}), (1.04, {"a", "b"})])
def test_places_within_a_tenth_of_the_nearest_distance_are_right(
    row_of_places: PlaceMap, x: float, right: set[str]
) -> None:
    assert right_places(row_of_places, np.array([x, 0.0, 0.0])) == right


def test_a_map_without_places_has_no_right_answer(row_of_places: PlaceMap) -> None:
    empty = PlaceMap("map", "map", row_of_places.navigation, (), (), {})
    assert right_places(empty, np.zeros(3)) == set()


def test_precision_counts_every_known_answer_and_recall_every_mapped_one(row_of_places: PlaceMap) -> None:
    summary = summarise(
        [
            judged(
                row_of_places,
                [
                    (image_at(1, 0.0), KNOWN_A),
                    (image_at(2, 4.0), KNOWN_A),  # wrong
                    (image_at(3, 0.0), UNKNOWN),
                    (image_at(4, 0.0), answer("lost")),
                    (image_at(5, 0.0, beyond_m=1.0), KNOWN_A),  # nearest, but in the room that the map does not have
                    (image_at(6, 0.0, beyond_m=1.0), UNKNOWN),
                    (image_at(7, 0.0, is_carried=True), KNOWN_A),
                    (image_at(8, 0.0, is_carried=True), UNKNOWN),
                ],
            )
        ]
    )
    assert summary.precision == Share(2, 4)
    assert summary.recall == Share(1, 4)
    assert summary.silent == Share(1, 2)
    assert summary.left_out == Share(0, 8)


def test_a_likely_place_that_is_not_said_to_be_known_is_not_counted_as_known(row_of_places: PlaceMap) -> None:
    summary = summarise([judged(row_of_places, [(image_at(1, 0.0), answer("unknown", "a"))])])
    assert summary.precision == Share(0, 0) and summary.recall == Share(0, 1)


def test_behind_a_doorway_only_a_wrong_place_counts(row_of_places: PlaceMap) -> None:
    within = [(image_at(1, 0.0, beyond_m=0.2), a) for a in (KNOWN_A, UNKNOWN, answer("known", "c"))]
    summary = summarise([judged(row_of_places, within)])
    assert summary.precision == Share(0, 1)
    assert summary.left_out == Share(2, 3)
    assert summary.recall == Share(0, 0) and summary.silent == Share(0, 0)


def test_images_of_another_building_are_known_to_nobody(row_of_places: PlaceMap) -> None:
    elsewhere = LookedAt(S, Attempt(None, (), "", 0, 0, 0.0), None, 0.0, False)
    summary = summarise([judged(row_of_places, [(elsewhere, KNOWN_A), (elsewhere, UNKNOWN)])])
    assert summary.precision == Share(0, 1) and summary.silent == Share(1, 2)


def test_calibration_error_is_of_all_known_answers(row_of_places: PlaceMap) -> None:
    answers = [
        (image_at(1, 0.0), answer("known", "a", 0.8)),
        (image_at(2, 0.0, beyond_m=1.0), answer("known", "a", 0.8)),
    ]
    assert summarise([judged(row_of_places, answers)]).calibration_error == pytest.approx(0.3)


HIJACK = TrueHijack(10 * S, 14 * S, to_unmapped=False)


@pytest.mark.parametrize(("right_at_s", "found"), [(23.9, True), (24.1, False)])
def test_seconds_to_the_right_place_count_from_when_the_robot_is_put_down(
    row_of_places: PlaceMap, right_at_s: float, found: bool
) -> None:
    before = (image_at(12, 0.0, is_carried=True), KNOWN_A)
    drive = judged(row_of_places, [before, (image_at(20, 4.0), KNOWN_A), (image_at(right_at_s, 0.0), KNOWN_A)], HIJACK)
    assert drive.found_again_s == pytest.approx(right_at_s - 14)
    assert summarise([drive]).found_again == Share(int(found), 1)


def test_a_hijack_into_the_unmapped_room_asks_for_no_place(row_of_places: PlaceMap) -> None:
    drive = judged(row_of_places, [(image_at(20, 0.0), KNOWN_A)], TrueHijack(10 * S, 14 * S, to_unmapped=True))
    assert drive.found_again_s is None and summarise([drive]).found_again == Share(0, 0)


def test_hijack_events_far_from_the_hijack_are_false_alarms(row_of_places: PlaceMap) -> None:
    events = [HijackEvent(round(t * S), "imu", "", 0.9) for t in (5.0, 11.5, 23.0, 24.5)]
    drive = judged(row_of_places, [], HIJACK, events)
    assert drive.noticed_s == pytest.approx(1.5) and drive.false_alarms == 2
    assert drive.undisturbed_s == pytest.approx(60 - 4 - 10)
    assert summarise([drive, judged(row_of_places, [], None, events[:1])]).false_alarms_per_hour == pytest.approx(
        3 * 3600 / (46 + 60)
    )


def test_of_nothing_there_is_no_share() -> None:
    assert Share(0, 0).value is None and str(Share(0, 0)) == "none" and Share(0, 0).interval == (0.0, 1.0)
    assert str(Share(3, 4)) == "75.0% (3 of 4; 30.1%-95.4%)"
