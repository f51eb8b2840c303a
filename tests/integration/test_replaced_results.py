"""A command that replaces an earlier run's results says so, in one line beside its output."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from station.main import app
from tests.support.recordings import record_made_up_room

pytestmark = pytest.mark.computing

MADE_UP = "tests.support.made_up_workers:StraightSlam"


def run(*arguments: object) -> Result:
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    assert result.exit_code == 0, result.output
    return result


def test_an_earlier_result_that_is_replaced_is_named_on_stderr(tmp_path: Path) -> None:
    recording = record_made_up_room(tmp_path / "drive.mcap")
    nav, built = tmp_path / "nav", tmp_path / "map"
    nav.mkdir()  # an empty folder is no earlier result
    commands = [
        ("the navigation", nav, ("slam", recording, "--backend", MADE_UP, "--out", nav, "--json")),
        ("the map", built, ("map", "build", nav, "--out", built, "--json")),
    ]
    for what, out, command in commands:
        first, again = run(*command), run(*command)
        assert first.stderr == ""
        assert again.stderr == f"station: {what} that {out} held from before is replaced\n"
        assert json.loads(again.stdout.splitlines()[-1]).keys() == json.loads(first.stdout.splitlines()[-1]).keys()
