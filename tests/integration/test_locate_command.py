"""`station locate`: the live current place over recorded data, and how it is judged."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import msgspec
import numpy as np
import pytest
from typer.testing import CliRunner, Result

from shared.calibration import REFERENCE_ROBOT
from shared.errors import ConfigError, DataError
from station.datasets import Dataset, open_dataset
from station.main import app
from station.maps.folder import load_map_folder, save_map_folder
from station.maps.store import MapStore
from station.model.frames import ImuBatch
from station.model.place_map import PlaceMap
from station.places.localisation.make_index import make_index
from station.places.localisation.map_index import MapIndex, fingerprint
from station.places.making.build import build_map
from station.places.making.changes import with_place_hidden
from station.places.tracking import current
from station.places.tracking.own_pictures import Judged, own_log_odds
from station.workers.replay import ReplayOptions, answer_line, has_live_poses, live_backend, replay
from tests.support.made_up_workers import made_up_navigation
from tests.support.paths import RECORDINGS
from tests.support.recordings import record_made_up_room

pytestmark = pytest.mark.computing

KITCHEN, FLIGHT = RECORDINGS / "redkitchen", RECORDINGS / "euroc_v1_01_flight"
MADE_UP = "tests.support.made_up_workers:StraightSlam"
ANSWER = {
    "state", "place", "room", "distance", "position_map", "t_robot_ns", "inliers", "alternatives", "reason", "map_id",
}  # fmt: skip
SUMMARY = {
    "answers", "known", "unknown", "lost", "right", "wrong", "precision", "recall", "position_error_median_m",
    "calibration_error",
}  # fmt: skip


def run(*arguments: str | Path) -> Result:
    result = CliRunner().invoke(app, [str(a) for a in arguments])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    assert result.exit_code == 0, result.output
    return result


def locate(*arguments: str | Path) -> Result:
    return run("locate", *arguments)


def answers_in(out: Path) -> list[dict[str, object]]:
    return [json.loads(line) for line in (out / "answers.jsonl").read_text().splitlines()]


@pytest.fixture(scope="module", autouse=True)
def indexes() -> Iterator[None]:
    """The pictures of a map are described and tried once, not by each command that asks in it: a second of each."""
    made: dict[str, MapIndex] = {}

    def once(place_map: PlaceMap) -> MapIndex:
        key = fingerprint(place_map)
        if key not in made:
            made[key] = make_index(place_map)
        return made[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("station.workers.places.make_index", once)
        yield


@pytest.fixture(scope="module")
def made_up(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of a made-up room, its map, and its pictures in a folder with the poses they were taken from."""
    root = tmp_path_factory.mktemp("made-up")
    record_made_up_room(root / "drive.mcap")
    navigation = made_up_navigation()
    save_map_folder(build_map(navigation), root / "map")
    images = root / "images"
    images.mkdir()
    for k, (T, encoded) in enumerate(
        zip(navigation.trajectory.T_world_body, navigation.keyframes.encoded, strict=True)
    ):
        (images / f"frame-{k:06d}.jpg").write_bytes(encoded)
        np.savetxt(images / f"frame-{k:06d}.pose.txt", T)
    camera = navigation.calibration.camera
    assert camera is not None
    (images / "camera.yaml").write_text(
        f"rate_hz: 10\nresolution: [{camera.width}, {camera.height}]\ncamera_model: pinhole\n"
        f"intrinsics: [{camera.fx}, {camera.fy}, {camera.cx}, {camera.cy}]\n"
        "distortion_model: radial-tangential\ndistortion_coefficients: [0, 0, 0, 0]\n"
    )
    return root


def test_places_are_looked_for_with_what_the_map_says_of_itself(
    made_up: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    judged: list[int] = []

    def own(pictures: Sequence[Judged], *odds: Any) -> float:
        judged.append(len(pictures))
        return own_log_odds(pictures, *odds)

    monkeypatch.setattr(current, "own_log_odds", own)
    locate(made_up / "map", made_up / "drive.mcap", "--out", tmp_path / "out", "--json")
    assert judged and min(judged) > 0


def test_a_recording_without_truth_gives_answers_and_no_judgement(made_up: Path, tmp_path: Path) -> None:
    result = locate(made_up / "map", made_up / "drive.mcap", "--out", tmp_path / "out", "--json")
    assert result.stderr == ""
    summary = json.loads(result.stdout.splitlines()[-1])
    assert summary["answers"] == 12 and summary["right"] is None and summary["truth"] == "none"
    answers = answers_in(tmp_path / "out")
    assert len(answers) == 12 and all(answer.keys() >= ANSWER and answer["room"] is None for answer in answers)
    assert {path.name for path in tmp_path.joinpath("out").iterdir()} == {"answers.jsonl", "over_time.png"}
    assert cv2.imread(str(tmp_path / "out" / "over_time.png")) is not None


def test_it_answers_as_a_replay_does(made_up: Path, tmp_path: Path) -> None:
    recording = made_up / "drive.mcap"
    locate(made_up / "map", recording, "--out", tmp_path / "located", "--backend", "sfm")
    replayed = replay(open_dataset(recording), ReplayOptions(MADE_UP), load_map_folder(made_up / "map"))
    run("replay", recording, "--map", made_up / "map", "--backend", MADE_UP, "--out", tmp_path / "replayed")
    lines = (tmp_path / "replayed" / "answers.jsonl").read_text().splitlines()
    assert lines == [answer_line(answer) for answer in replayed.answers]
    for line, located in zip(lines, answers_in(tmp_path / "located"), strict=True):
        replayed_too = json.loads(line)
        assert replayed_too.keys() == located.keys() and replayed_too["t_robot_ns"] == located["t_robot_ns"]


def test_true_poses_judge_the_answers(made_up: Path, tmp_path: Path) -> None:
    images = made_up / "images"
    result = locate(made_up / "map", images, "--map-truth", images, "--rate", "10", "--out", tmp_path / "out", "--json")
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert json.loads(result.stdout.splitlines()[-1]) == summary
    assert summary.keys() >= SUMMARY and summary["truth"] == "map" and summary["answers_with_truth"] == 60
    states = [answer["state"] for answer in answers_in(tmp_path / "out")]
    assert [summary[state] for state in ("known", "unknown", "lost")] == [
        states.count(state) for state in ("known", "unknown", "lost")
    ]
    assert summary["answers"] == 60 and summary["right"] + summary["wrong"] == summary["known"]


def test_a_replay_in_a_given_map_is_judged_as_locating_is(made_up: Path, tmp_path: Path) -> None:
    words = made_up / "images", "--map", made_up / "map", "--backend", MADE_UP, "--out"
    run("replay", *words, tmp_path / "out")
    summary, answers = json.loads((tmp_path / "out" / "summary.json").read_text()), answers_in(tmp_path / "out")
    assert summary.keys() >= SUMMARY and summary["answers"] == len(answers)
    assert summary["known"] == sum(answer["state"] == "known" for answer in answers)
    assert summary["truth"] in ("answers", "none")  # fitted to the answers, or too few of them have a position
    run("replay", made_up / "drive.mcap", *words[1:], tmp_path / "without truth")
    assert not (tmp_path / "without truth" / "summary.json").exists()


@pytest.mark.parametrize(("rate", "count"), [("5", 30), ("2.5", 15), ("1", 6)])
def test_as_many_pictures_a_second_are_looked_for_as_asked(
    made_up: Path, tmp_path: Path, rate: str, count: int
) -> None:
    locate(made_up / "map", made_up / "images", "--rate", rate, "--out", tmp_path / "out")
    assert len(answers_in(tmp_path / "out")) == count


def test_what_cannot_be_judged_is_said(made_up: Path, tmp_path: Path) -> None:
    result = locate(made_up / "map", made_up / "images", "--rate", "1", "--out", tmp_path / "out")
    assert "the answers are not judged" in result.stderr and "give --map-truth" in result.stderr
    assert json.loads((tmp_path / "out" / "summary.json").read_text())["precision"] is None


def test_a_map_of_the_store_is_found_by_its_id_and_results_are_replaced(made_up: Path, tmp_path: Path) -> None:
    store = MapStore(tmp_path / "station" / "maps")
    kept = load_map_folder(made_up / "map")
    store.save(kept)
    store.close()
    words = made_up / "images", "--rate", "1", "--out", tmp_path / "out"
    locate(made_up / "map", *words)
    before = (tmp_path / "out" / "answers.jsonl").read_text()
    locate(kept.id, *words, "--data", tmp_path / "station")
    assert (tmp_path / "out" / "answers.jsonl").read_text() == before
    assert not [path for path in tmp_path.iterdir() if path.name.startswith(".")]


def test_slam_runs_beside_where_it_has_poses_on_the_way(made_up: Path) -> None:
    imu = ImuBatch(np.arange(3), np.zeros((3, 3)), np.zeros((3, 3)))

    def film(rate_hz: float, frames: int = 20) -> Dataset:
        times = (np.arange(frames) * 1e9 / rate_hz).astype(np.int64)
        return Dataset(Path("x"), "mcap", REFERENCE_ROBOT, True, times, None, imu=imu)

    assert has_live_poses(film(20), "auto")
    assert not has_live_poses(film(20), "sfm")
    assert not has_live_poses(replace(film(20), imu=None), "auto")
    assert not has_live_poses(film(1), "auto")  # keyframes
    assert not has_live_poses(film(20, frames=1), "auto")
    assert not has_live_poses(open_dataset(made_up / "images"), "auto")
    in_hands = replace(film(20), calibration=msgspec.structs.replace(REFERENCE_ROBOT, rig="hand-held"))
    assert has_live_poses(in_hands, "auto") and live_backend(in_hands, "auto") == "ukf"
    assert not has_live_poses(in_hands, "sfm")


def test_mistakes_get_one_sentence_and_leave_nothing(made_up: Path, tmp_path: Path) -> None:
    place_map = load_map_folder(made_up / "map")
    for place in place_map.places:
        place_map = with_place_hidden(place_map, place.id, hidden=True)
    save_map_folder(place_map, tmp_path / "hidden")
    images, mcap, out = made_up / "images", made_up / "drive.mcap", tmp_path / "out"
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine.txt").write_text("x")
    for words, said in (
        ((images, images, "--out", out), "holds no map"),
        ((made_up / "map", made_up / "nothing", "--out", out), "does not exist"),
        ((made_up / "map", images, "--out", out, "--first", "999"), "none of them in the range"),
        ((made_up / "map", images, "--out", out, "--map-truth", mcap), "holds no true poses"),
        ((made_up / "map", mcap, "--out", out, "--map-truth", images), "nothing to judge"),
        ((tmp_path / "hidden", images, "--out", out), "holds no place"),
        ((made_up / "map", images, "--out", tmp_path / "full"), "holds mine.txt"),
    ):
        with pytest.raises(DataError, match=said):
            locate(*words)
    for option, value in (
        ("--rate", "0"),
        ("--rate", "-1"),
        ("--rate", "nan"),
        ("--rate", "1e-300"),
        ("--rate", "inf"),
        ("--backend", "nothing"),
    ):
        with pytest.raises(ConfigError):
            locate(made_up / "map", images, "--out", out, option, value)
    assert {path.name for path in tmp_path.iterdir()} == {"full", "hidden"}


@pytest.mark.slow
@pytest.mark.skipif(not KITCHEN.is_dir(), reason="../shared/data/redkitchen is not here")
def test_a_real_kitchen_is_found_in_its_own_map(tmp_path: Path) -> None:
    run("slam", KITCHEN, "--last", "60", "--out", tmp_path / "nav")
    run("map", "build", tmp_path / "nav", "--out", tmp_path / "map")
    locate(tmp_path / "map", KITCHEN, "--last", "60", "--map-truth", KITCHEN, "--rate", "15", "--out", tmp_path / "out")
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["answers"] == summary["answers_with_truth"] == 31
    assert summary["position_error_median_m"] < 0.1
    assert not summary["wrong"]


@pytest.mark.skipif(not FLIGHT.is_dir(), reason="../shared/data/euroc_v1_01_flight is not here")
def test_a_real_flight_with_imu_is_asked_in_the_map_of_a_made_up_room(made_up: Path, tmp_path: Path) -> None:
    """A camera, a clock and a place that the map knows nothing of: no place is named."""
    locate(made_up / "map", FLIGHT, "--rate", "2", "--backend", "ukf", "--out", tmp_path / "out")
    answers = answers_in(tmp_path / "out")
    assert len(answers) == 9 and {answer["state"] for answer in answers} <= {"unknown", "lost"}
    assert all(answer["reason"] for answer in answers)
