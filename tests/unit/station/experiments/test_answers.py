"""Answers of the current place judged by true poses."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shared.calibration import Calibration
from shared.errors import DataError, DegenerateGeometry
from shared.geometry import FloatArray, sim3, so3_exp, transform
from station.datasets import Dataset, Truth
from station.experiments.answer_figures import CALIBRATION, OVER_TIME, draw_answers, kinds_of
from station.experiments.answers import (
    MIN_POSITIONS,
    MapFrame,
    frame_of_answers,
    frame_of_map,
    judge_answers,
    nearest_places,
    true_positions,
)
from station.model.frames import ImageFrame
from station.model.place_answer import HijackEvent, PlaceAnswer, PlaceCandidate, PlaceState, RoomCandidate
from station.model.place_map import Place
from station.places.localisation.localizer import Attempt
from station.places.tracking.tracker import PlaceTracker
from tests.support.drives.playback import PlayedBackLocalizer
from tests.support.drives.recorded import LookedAt
from tests.support.places import make_map, pose, seen
from tests.support.plans import two_rooms
from tests.support.synthetic_home import CAMERA, drive, furnished_room, navigate

SECOND = 1_000_000_000
IN_THE_TRUTHS_FRAME = MapFrame("map", np.tile(np.eye(4), (100, 1, 1)))


def place(name: str, *centroid: float) -> Place:
    none = np.zeros(0, dtype=np.int64)
    return Place(name, name.upper(), np.array(centroid), 1.0, none, none, -1, 0.5)


PLACES = (place("west", 0.0, 0.0, 0.0), place("east", 10.0, 0.0, 0.0))


def answer(
    state: PlaceState, place_id: str = "", probability: float = 0.9, position: FloatArray | None = None, t_s: float = 0
) -> PlaceAnswer:
    named = PlaceCandidate(place_id, place_id.upper(), probability) if state == "known" else None
    return PlaceAnswer(state, named, None, position, round(t_s * SECOND), None, None, 0, (), "because")


def dataset(truth: Truth | None, time_shift_s: float = 0.0) -> Dataset:
    camera = msgspec.structs.replace(CAMERA, time_shift_s=time_shift_s)
    calibration = Calibration(camera=camera, imu=None)
    return Dataset(Path("drive"), "images", calibration, True, np.zeros(0, np.int64), None, truth=truth)


def first_of(frame: MapFrame, count: int) -> MapFrame:
    return MapFrame(frame.source, frame.T_map_truth[:count])


def test_a_summary_counts_what_was_said_and_judges_what_was_known() -> None:
    p_true = np.array([[1.0, 0, 0], [1.0, 0, 0], [9.0, 0, 0], [1.0, 0, 0], [np.nan] * 3])
    answers = [
        answer("known", "west", 0.95, np.array([1.1, 0, 0])),
        answer("known", "east", 0.65, np.array([9.0, 0, 0])),
        answer("unknown", position=np.array([9.0, 0.3, 0])),
        answer("lost"),
        answer("known", "west"),  # nobody knows where the robot was
    ]
    judged = judge_answers(answers, PLACES, p_true, first_of(IN_THE_TRUTHS_FRAME, 5))
    assert judged.summary() == {
        "answers": 5,
        "known": 3,
        "unknown": 1,
        "lost": 1,
        "right": 1,
        "wrong": 1,
        "precision": 0.5,
        "recall": 0.25,
        "position_error_median_m": pytest.approx(0.3),
        "calibration_error": pytest.approx((0.05 + 0.65) / 2),
        "truth": "map",
        "answers_with_truth": 4,
        **dict.fromkeys(("room_known", "room_right", "room_precision", "room_recall")),
    }
    assert kinds_of(judged) == ["right", "wrong", "unknown", "lost", "known, not judged"]


def test_places_about_as_near_as_the_nearest_are_right_too() -> None:
    assert nearest_places(PLACES, np.array([4.9, 0.0, 0.0])) == {"west", "east"}
    assert nearest_places(PLACES, np.array([4.0, 0.0, 0.0])) == {"west"}


def test_without_truth_nothing_is_right_or_wrong() -> None:
    frame = MapFrame("none", np.full((2, 4, 4), np.nan), "no truth")
    judged = judge_answers([answer("known", "west"), answer("lost")], PLACES, np.full((2, 3), np.nan), frame)
    summary = judged.summary()
    judgements = ("right", "wrong", "precision", "recall", "position_error_median_m", "calibration_error")
    assert (summary["known"], summary["lost"], summary["truth"]) == (1, 1, "none")
    assert [summary[key] for key in judgements] == [None] * 6


def test_no_answers_are_summed_up_too(tmp_path: Path) -> None:
    judged = judge_answers([], PLACES, np.zeros((0, 3)), MapFrame("map", np.zeros((0, 4, 4))))
    assert judged.summary()["answers"] == 0 and judged.summary()["recall"] is None
    draw_answers(judged, (), "nothing", tmp_path)
    assert not list(tmp_path.iterdir())


@given(
    log_scale=st.floats(-2, 2),
    turn=st.tuples(*[st.floats(-3, 3)] * 3),
    shift=st.tuples(*[st.floats(-50, 50)] * 3),
    seed=st.integers(0, 2**32 - 1),
)
def test_the_frame_and_unit_of_the_map_do_not_count(
    log_scale: float, turn: tuple[float, float, float], shift: tuple[float, float, float], seed: int
) -> None:
    rng = np.random.default_rng(seed)
    p_true = rng.uniform(-2, 12, (20, 3))
    answers = [answer("known", str(rng.choice(["west", "east"])), position=p + rng.normal(0, 0.2, 3)) for p in p_true]
    T = sim3(float(np.exp(log_scale)), so3_exp(np.array(turn)), np.array(shift))
    before = judge_answers(answers, PLACES, p_true, first_of(IN_THE_TRUTHS_FRAME, 20))
    moved = [
        answer("known", a.place.id, position=transform(T, a.position_map))
        for a in answers
        if a.place is not None and a.position_map is not None
    ]
    places = [place(one.id, *transform(T, one.centroid_map)) for one in PLACES]
    after = judge_answers(moved, places, p_true, MapFrame("map", np.tile(T, (20, 1, 1))))
    assert after.is_right.tolist() == before.is_right.tolist()
    np.testing.assert_allclose(after.position_error_m, before.position_error_m, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("shift_s", [0.5, -0.5])
def test_an_answer_is_judged_by_where_the_robot_was_at_its_time(shift_s: float) -> None:
    """The robot drives at 1 m/s along x; truth and odometry are by the IMU's clock, pictures by the camera's."""
    t = np.arange(0, 3 * SECOND, SECOND // 100)
    path = np.array([pose(1e-9 * ns, 0.0) for ns in t])
    place_map = make_map()
    calibration = place_map.navigation.calibration
    assert calibration.camera is not None
    camera = msgspec.structs.replace(calibration.camera, time_shift_s=shift_s)
    picture_ns = round((1.0 - shift_s) * SECOND)  # taken where x is 1
    found = replace(seen(1.0, pose(1.0, 0.0)), t_robot_ns=picture_ns)
    looked_at = LookedAt(picture_ns, Attempt(found, (found,), "found", 400, 100, 0.9), None, 0.0, False)
    tracker = PlaceTracker([place_map], msgspec.structs.replace(calibration, camera=camera),
                           PlayedBackLocalizer([place_map], [looked_at]))  # fmt: skip
    for ns, T in zip(t, path, strict=True):
        if ns > max(picture_ns, SECOND):  # what came before the picture was looked for
            break
        tracker.on_odometry(int(ns), T)
    tracker.on_frame(ImageFrame(0, picture_ns, 0, b""))
    said = tracker.answer(picture_ns)
    p = true_positions([said, answer("lost", t_s=9.0)], dataset(Truth(t, path), shift_s))
    assert said.position_map is not None
    np.testing.assert_allclose(p[0], said.position_map, atol=0.05)
    assert np.isnan(p[1]).all()
    assert np.isnan(true_positions([answer("lost")], dataset(None))).all()


def test_the_mapping_drives_truth_says_where_the_map_lies() -> None:
    T = sim3(0.4, so3_exp(np.array([0.3, -1.0, 2.0])), np.array([4.0, 5.0, 6.0]))
    poses = drive(furnished_room(3), 5, frames=30)
    navigation = navigate(furnished_room(3), poses, 5, T_nav_world=T, metric=False, gravity=False, images=False)
    truth = Truth(navigation.trajectory.t_robot_ns, poses)
    frame = frame_of_map(navigation, dataset(truth), 3)
    assert frame.source == "map"
    np.testing.assert_allclose(frame.T_map_truth, np.tile(T, (3, 1, 1)), atol=1e-9)
    for seed in range(5):
        walk = poses.copy()
        walk[:, :3, 3] = np.cumsum(np.random.default_rng(seed).normal(0, 0.3, (30, 3)), axis=0)
        with pytest.raises(DegenerateGeometry, match=r"of another drive|positions contradict orientations"):
            frame_of_map(navigation, dataset(Truth(truth.t_robot_ns, walk)), 3)
    with pytest.raises(DegenerateGeometry, match="0 poses"):
        frame_of_map(navigation, dataset(Truth(truth.t_robot_ns + 10**15, poses)), 3)
    with pytest.raises(DataError, match="no true poses"):
        frame_of_map(navigation, dataset(None), 3)


def wandering_answers(T: FloatArray, rng: np.random.Generator, count: int = 60) -> tuple[list[PlaceAnswer], FloatArray]:
    """Answers good to 2 cm along a path, every fifth of them elsewhere; and the true positions."""
    p_true = np.cumsum(rng.normal(0, 0.3, (count, 3)), axis=0)
    said = transform(T, p_true + rng.normal(0, 0.02, p_true.shape))
    said[::5] += rng.normal(0, 3, said[::5].shape)
    return [answer("known", "west", position=p, t_s=k) for k, p in enumerate(said)], p_true


def test_the_frame_is_found_from_answers_of_which_some_are_wrong() -> None:
    T = sim3(1.7, so3_exp(np.array([0.3, -1.0, 2.0])), np.array([4.0, 5.0, 6.0]))
    answers, p_true = wandering_answers(T, np.random.default_rng(4))
    frame = frame_of_answers(answers, p_true)
    assert frame.source == "answers"
    for fitted in frame.T_map_truth:
        np.testing.assert_allclose(transform(fitted, p_true), transform(T, p_true), atol=0.15)
    error = judge_answers(answers, PLACES, p_true, frame).position_error_m
    good = np.arange(60) % 5 != 0
    assert np.median(error[good]) < 0.06 and np.median(error[~good]) > 0.5


def test_an_answer_is_judged_in_a_frame_that_it_did_not_make() -> None:
    """Twelve answers at the end share an error: fitted to themselves they would look better."""
    answers, p_true = wandering_answers(np.eye(4), np.random.default_rng(6))
    late = [answer("known", "west", position=p + np.array([1.0, 0, 0]), t_s=k + 48) for k, p in enumerate(p_true[48:])]
    frame = frame_of_answers([*answers[:48], *late], p_true)
    error = judge_answers([*answers[:48], *late], PLACES, p_true, frame).position_error_m
    np.testing.assert_allclose(error[48:], 1.0, atol=0.1)


def test_few_positions_judge_nothing() -> None:
    answers, p_true = wandering_answers(np.eye(4), np.random.default_rng(5))
    few = frame_of_answers(answers[: MIN_POSITIONS - 1], p_true[: MIN_POSITIONS - 1])
    assert few.source == "none" and few.why.startswith(f"{MIN_POSITIONS - 1} answers have a position")
    one_spot = [answer("known", "west", position=np.ones(3)) for _ in range(30)]
    assert frame_of_answers(one_spot, np.ones((30, 3))).source == "none"


def test_figures_are_drawn_of_all_states(tmp_path: Path) -> None:
    answers, p_true = wandering_answers(np.eye(4), np.random.default_rng(7))
    answers += [answer("lost", t_s=61), answer("unknown", t_s=62)]
    p_true = np.vstack([p_true, p_true[-2:]])
    judged = judge_answers(answers, PLACES, p_true, first_of(IN_THE_TRUTHS_FRAME, 62))
    draw_answers(judged, [HijackEvent(30 * SECOND, "imu", "lifted", 0.9)], "a drive", tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {OVER_TIME, CALIBRATION}


def test_rooms_are_judged_by_the_map_where_the_robot_truly_was() -> None:
    said = [(1.0, "room-l"), (1.0, "room-k"), (2.9, "room-k"), (5.0, None), (50.0, "room-l")]  # true x, room named
    answers = [
        PlaceAnswer(
            "lost", None, None, None, k * SECOND, None, None, 0, (), "because",
            room=None if room is None else RoomCandidate(room, room, 0.9),
        )
        for k, (_, room) in enumerate(said)
    ]  # fmt: skip
    p_true = np.array([[x, 0.0, 0.0] for x, _ in said])
    frame = MapFrame("map", np.tile(np.eye(4), (len(said), 1, 1)))
    summary = judge_answers(answers, make_map().places, p_true, frame, two_rooms()).summary()
    assert (summary["room_known"], summary["room_right"]) == (4, 2)
    assert (summary["room_precision"], summary["room_recall"]) == (0.5, 0.5)
