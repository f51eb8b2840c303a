"""Replay: the same recording gives the same trajectory, map and answers, bit for bit, on any number of threads."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import msgspec
import pytest
from typer.testing import CliRunner

from robot.simulation.atlas import default_cache_dir
from robot.simulation.config import SimulationConfig
from robot.simulation.recording import record_drive
from robot.simulation.routes import plan_route
from robot.simulation.worlds import make_world
from station.commands.replay import Metronome
from station.datasets import Dataset, open_dataset
from station.main import app
from station.model.frames import ImageFrame
from station.model.slam_update import SlamUpdate
from station.slam.ukf.backend import UkfBackend
from station.vision.features import FeatureExtractor, Features, extract_encoded
from station.workers.replay import ReplayOptions
from station.workers.replay import replay as replay_drive
from tests.support.made_up_workers import StraightSlam, focal_fit, made_up_navigation
from tests.support.paths import RECORDINGS
from tests.support.recordings import record_made_up_room

pytestmark = pytest.mark.computing

KEYFRAMES = RECORDINGS / "euroc_v1_01_keyframes"
MADE_UP = "tests.support.made_up_workers:StraightSlam"
MISFIT = "tests.integration.test_replay:MisfitUkf"
DESCRIBING = "tests.integration.test_replay:DescribingSlam"


class DescribingSlam(StraightSlam):
    """Has described its keyframes itself, while it made the map."""

    def keyframe_pictures(self) -> list[bytes]:
        return list(made_up_navigation().keyframes.encoded)

    def keyframe_features(self, number: int) -> Features:
        up_deg = made_up_navigation().calibration.up_in_image_deg
        return extract_encoded(self.keyframe_pictures()[number], FeatureExtractor(up_deg=up_deg))


def replay(path: Path, *words: str) -> dict[str, object]:
    result = CliRunner().invoke(app, ["replay", str(path), *words, "--json"])
    assert result.exit_code == 0, result.output
    content: dict[str, object] = msgspec.json.decode(result.stdout)
    return content


def test_the_same_recording_gives_the_same_bits(tmp_path: Path) -> None:
    path = record_made_up_room(tmp_path / "drive.mcap")
    first = replay(path, "--backend", MADE_UP, "--threads", "1", "--out", str(tmp_path / "out"))
    assert replay(path, "--backend", MADE_UP, "--threads", "2") == first
    assert first["answers_given"] == 12
    hashes = json.loads((tmp_path / "out" / "hashes.json").read_text())
    assert hashes == {key: first[key] for key in ("trajectory", "map", "answers")}
    assert len((tmp_path / "out" / "answers.jsonl").read_text().splitlines()) == 12
    in_its_map = replay(path, "--backend", MADE_UP, "--map", str(tmp_path / "out" / "map"))
    assert in_its_map["map"] == first["map"]


@pytest.fixture(scope="module")
def simulated_drive(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """Nine seconds in a furnished room."""
    path = tmp_path_factory.mktemp("simulated") / "drive"
    config = SimulationConfig(camera_rate_hz=12.0)
    room = make_world("room", 1, config)
    route = plan_route(room, "local", 0, config.body.radius_m)
    record_drive(room, route, config, 0, path, default_cache_dir(), max_duration_s=9.0)
    return open_dataset(path)


class MisfitUkf(UkfBackend):
    """Finds the focal length 3 % too long."""

    def add_frame(self, frame: ImageFrame) -> SlamUpdate:
        return replace(super().add_frame(frame), calibration_fit=focal_fit(0.97))


def test_a_recordings_own_fit_of_its_calibration_counts_as_in_the_running_station(simulated_drive: Dataset) -> None:
    replayed = replay_drive(simulated_drive, ReplayOptions("ukf"))
    known_map = replayed.place_map
    assert "known" in {answer.state for answer in replayed.answers}
    first, *misfits = replay_drive(simulated_drive, ReplayOptions(MISFIT), known_map).answers
    assert first.state == "known"  # SLAM has said nothing yet
    assert "known" not in {answer.state for answer in misfits}
    assert any(answer.reason.startswith("the calibration does not fit") for answer in misfits)


def test_pictures_that_slam_described_are_not_described_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    data = open_dataset(record_made_up_room(tmp_path / "drive.mcap"))
    expected = replay_drive(data, ReplayOptions(MADE_UP))
    monkeypatch.setattr("station.places.localisation.described_pictures.extract_encoded", None)
    assert replay_drive(data, ReplayOptions(DESCRIBING)).hashes() == expected.hashes()


def test_a_different_recording_gives_other_answers(tmp_path: Path) -> None:
    whole = replay(record_made_up_room(tmp_path / "a" / "drive.mcap"), "--backend", MADE_UP)
    shorter = replay(record_made_up_room(tmp_path / "b" / "drive.mcap", frames=9), "--backend", MADE_UP)
    assert whole["answers"] != shorter["answers"] and whole["map"] != shorter["map"]


@pytest.mark.slow
def test_real_images_give_the_same_bits_on_one_and_two_threads() -> None:
    if not KEYFRAMES.is_dir():
        pytest.skip("../shared/data/euroc_v1_01_keyframes is not here")
    one = replay(KEYFRAMES, "--last", "11", "--threads", "1")
    assert replay(KEYFRAMES, "--last", "11", "--threads", "2") == one
    assert one["places"]


def test_a_replay_says_what_it_does_and_how_far_it_is(tmp_path: Path) -> None:
    told: list[str | int] = []
    replay_drive(
        open_dataset(record_made_up_room(tmp_path / "drive.mcap")),
        ReplayOptions(MADE_UP),
        pace=told.append,
        say=told.append,
    )
    steps = [one for one in told if isinstance(one, str)]
    assert len(steps) == 5 and told[0] == steps[0]
    # Recorded time goes by twice: while it follows the robot, and while it looks for the place.
    for step, ends in ((steps[0], steps[1]), (steps[4], None)):
        times = told[told.index(step) + 1 : None if ends is None else told.index(ends)]
        assert len(times) > 12 and times == sorted(times)


def test_nothing_of_the_progress_gets_into_files_and_pipes(tmp_path: Path) -> None:
    result = CliRunner().invoke(
        app, ["replay", str(record_made_up_room(tmp_path / "drive.mcap")), "--backend", MADE_UP]
    )
    assert result.exit_code == 0 and result.stderr == ""


def test_recorded_time_is_kept_at_the_speed_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    now_s = [100.0]
    monkeypatch.setattr("time.monotonic", lambda: now_s[0])
    monkeypatch.setattr("time.sleep", lambda s: now_s.__setitem__(0, now_s[0] + s))
    metronome = Metronome(2.0)
    for t_s in (5, 6, 9):
        metronome.wait(t_s * 10**9)
    assert now_s[0] == pytest.approx(102.0)
    metronome.wait(5 * 10**9)  # the second pass begins
    metronome.wait(6 * 10**9)
    assert now_s[0] == pytest.approx(102.5)


def test_what_cannot_be_replayed_is_one_sentence(tmp_path: Path) -> None:
    path = record_made_up_room(tmp_path / "drive.mcap", frames=2)
    for words, said in (
        ([str(path), "--backend", MADE_UP], "fewer than 3 frames"),
        ([str(path), "--speed", "0"], "--speed"),
        ([str(path), "--threads", "0"], "threads"),
        ([str(path), "--map", "nothing", "--data", str(tmp_path)], "no map"),
        ([str(path), "--out", str(tmp_path)], "exists already"),
    ):
        result = CliRunner().invoke(app, ["replay", *words])
        assert result.exit_code == 1 and said in str(result.exception)
