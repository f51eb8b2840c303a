"""The thesis' experiments by name."""

from pathlib import Path

import pytest

from shared.errors import ConfigError, DataError
from station.commands.options import overridden
from station.experiments.inputs import FrameRange
from station.experiments.presets import SlamChoice, find_preset, make_dataset


def test_second_and_third_share_the_first_drive_and_differ_in_the_other() -> None:
    second, third = find_preset("II", 4, None), find_preset("III", 4, None)
    assert second.navigations[0] == third.navigations[0]
    assert "triangle_b" in second.navigations[1] and "triangle_c" in third.navigations[1]
    assert second.navigations[0] != find_preset("II", 5, None).navigations[0]


def test_the_first_uses_the_prefix_of_one_drive(tmp_path: Path) -> None:
    states = tmp_path / "mav0" / "state_groundtruth_estimate0"
    states.mkdir(parents=True)
    (states / "data.csv").touch()
    first = find_preset("I", 0, tmp_path)
    assert first.navigations[0] == first.navigations[1]
    assert first.frames == (FrameRange(0, 599), FrameRange(0, 399))
    assert (first.slam.backend, find_preset("II", 0, None).slam.backend) == ("ukf", "sfm")
    assert any("stand" in s or "rendered" in s for s in first.story.setting)
    with pytest.raises(ConfigError, match="needs --euroc"):
        find_preset("I", 0, tmp_path / "nowhere")


def test_the_first_as_the_thesis_ran_it_uses_the_same_data(tmp_path: Path) -> None:
    states = tmp_path / "mav0" / "state_groundtruth_estimate0"
    states.mkdir(parents=True)
    (states / "data.csv").touch()
    ours = find_preset("I", 3, tmp_path)
    theirs = find_preset(ours.as_thesis, 3, tmp_path)
    assert (theirs.navigations, theirs.frames) == (ours.navigations, ours.frames)
    assert theirs.slam == SlamChoice("ukf", landmarks="thesis", initial_state="given")
    assert (theirs.mode, theirs.thesis.eps, theirs.thesis.min_pts, theirs.thesis.inlier_ratio) == (
        "thesis",
        0.3,
        11,
        0.75,
    )
    assert not theirs.as_thesis and "true state" in " ".join(theirs.story.setting)
    assert ours.slam.initial_state == "own"


def test_an_option_replaces_one_of_the_numbers_set_by_hand() -> None:
    by_hand = find_preset("II", 0, None).thesis
    assert overridden(by_hand, eps=None, min_pts=None, inlier_ratio=None) == by_hand
    changed = overridden(by_hand, eps=0.1, min_pts=None, inlier_ratio=None)
    assert (changed.eps, changed.min_pts, changed.normalise) == (0.1, by_hand.min_pts, True)


def test_a_failed_simulation_is_one_sentence_and_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="robot-sim could not make drive1"):
        make_dataset(("dataset", "--world", "no such world"), tmp_path / "data" / "drive1")
    assert list((tmp_path / "data").iterdir()) == []


def test_a_drive_is_used_again_only_where_just_that_one_was_made(tmp_path: Path) -> None:
    short = ("dataset", "--world", "room", "--route", "tour", "--max-duration", "1")
    made = make_dataset((*short, "--seed", "1"), tmp_path / "drive1")
    (made / "note").touch()
    assert make_dataset((*short, "--seed", "1"), made) == made
    with pytest.raises(DataError, match="another navigation"):
        make_dataset((*short, "--seed", "2"), made)
    assert (made / "note").is_file() and (made / "mav0").is_dir()  # it is left as it was, both times


@pytest.mark.parametrize(("text", "expected"), [("0-398", (0, 398)), ("7-", (7, None)), ("-9", (None, 9))])
def test_frame_ranges_are_read(text: str, expected: tuple[int | None, int | None]) -> None:
    frames = FrameRange.parse(text, "--frames1")
    assert (frames.first, frames.last) == expected


@pytest.mark.parametrize("text", ["", "-", "a-b", "1..2", "9-3"])
def test_wrong_frame_ranges_name_the_option(text: str) -> None:
    with pytest.raises(ConfigError, match="--frames1"):
        FrameRange.parse(text, "--frames1")
