"""A mistake on the command line is answered with one sentence, by every program."""

import sys
from collections.abc import Callable
from pathlib import Path

import pytest
import typer

from robot.main import main as robot_main
from robot.simulation.cli import main as simulation_main
from shared.command_line import run_program
from shared.errors import DataError
from station.main import main as station_main


def end_of(main: Callable[[], None], arguments: list[str], monkeypatch: pytest.MonkeyPatch) -> int:
    monkeypatch.setattr(sys, "argv", ["program", *arguments])
    with pytest.raises(SystemExit) as end:
        main()
    code = end.value.code or 0
    assert isinstance(code, int)
    return code


@pytest.mark.parametrize(
    ("main", "arguments", "words"),
    [
        (station_main, ["slam"], ["station: ", "'dataset'", "station slam --help"]),
        (station_main, ["slam", "x", "--out", "y", "--step", "two"], ["--step", "integer", "station slam --help"]),
        (station_main, ["register", "a", "b", "--scale", "maybe"], ["'maybe'", "--scale"]),
        (station_main, ["flyy"], ["flyy", "station --help"]),
        (station_main, ["map", "build", "--nothing"], ["--nothing", "station map build --help"]),
        (robot_main, ["--devices", "none"], ["robot-server: ", "'none'", "--devices"]),
        (simulation_main, ["dataset"], ["robot-sim: ", "--out"]),
    ],
)
def test_a_mistake_in_usage_gets_one_sentence(
    main: Callable[[], None],
    arguments: list[str],
    words: list[str],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert end_of(main, arguments, monkeypatch) == 2
    output = capsys.readouterr()
    assert output.out == "" and len(output.err.splitlines()) == 1
    for word in words:
        assert word in output.err


@pytest.mark.parametrize("main", [station_main, robot_main, simulation_main])
def test_help_is_no_mistake(
    main: Callable[[], None], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert end_of(main, ["--help"], monkeypatch) == 0
    assert "--help" in capsys.readouterr().out


def test_the_defaults_of_serve_are_values(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    assert end_of(station_main, ["serve", "--help"], monkeypatch) == 0
    text = capsys.readouterr().out
    assert "127.0.0.1:7400" in text and "8080" in text and "member" not in text


def test_nothing_asked_shows_what_can_be(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    end_of(station_main, [], monkeypatch)
    output = capsys.readouterr()
    assert "slam" in output.out + output.err


def test_an_error_of_ours_keeps_its_sentence_and_code(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert end_of(station_main, ["export", "/nowhere", "--out", "x", "--format", "tum"], monkeypatch) == 1
    assert capsys.readouterr().err.startswith("station: /nowhere is no folder")


@pytest.mark.parametrize("folder", ["", "a" * 300, "/dev/null"])
@pytest.mark.parametrize(
    "command",
    [
        ["map", "list"],
        ["access", "list"],
        ["access", "init"],
        ["robots"],
        ["recordings", "verify"],
        ["doctor"],
        ["export", "map-1", "--out", "x", "--format", "tum"],
    ],
)
def test_a_data_folder_that_is_none_is_refused_by_every_command(
    command: list[str],
    folder: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert end_of(station_main, [*command, "--data", folder], monkeypatch) == 1
    said = capsys.readouterr().err
    assert said.startswith("station: --data") and "no folder" in said and len(said) < 350


@pytest.mark.parametrize("main", [station_main, robot_main])
def test_a_name_too_long_for_any_file_gets_one_short_sentence(
    main: Callable[[], None], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    words = (
        ["evaluate", "a" * 5000, "b"] if main is station_main else ["--devices", "recorded", "--dataset", "a" * 5000]
    )
    assert end_of(main, words, monkeypatch) == 1
    said = capsys.readouterr().err
    assert "too long" in said and len(said) < 350 and said.count("\n") == 1


def test_a_full_disk_gets_one_sentence(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    app = typer.Typer()

    @app.command()
    def fill() -> None:
        Path("/dev/full").write_text("more than fits")

    assert end_of(lambda: run_program(app, "station"), [], monkeypatch) == 1
    said = capsys.readouterr().err
    assert said.startswith("station: ") and "make room" in said and said.count("\n") == 1


def test_what_a_file_holds_reaches_no_terminal_as_it_is(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    app = typer.Typer()

    @app.command()
    def read() -> None:
        raise DataError("words.toml: \x1b[31mred\u202e is no room")

    assert end_of(lambda: run_program(app, "station"), [], monkeypatch) == 1
    said = capsys.readouterr().err
    assert "red" in said and said.rstrip("\n").isprintable()
