"""`station map …` over the station's own maps."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from shared.errors import DataError
from station.main import app


def refusal(*words: str | Path) -> str:
    """The sentence with which a command ends; it has printed nothing."""
    result = CliRunner().invoke(app, ["map", *map(str, words)])
    assert isinstance(result.exception, DataError) and not result.stdout
    return str(result.exception)


@pytest.fixture
def data(tmp_path: Path) -> Path:
    """A station's folder that has no maps yet."""
    folder = tmp_path / "data"
    folder.mkdir()
    return folder


def test_repairing_from_a_folder_that_is_not_there_is_refused_and_nothing_is_made(data: Path, tmp_path: Path) -> None:
    (tmp_path / "copy.tar").write_bytes(b"")
    for wrong in ("mistyped", "copy.tar"):
        said = refusal("repair", data, tmp_path / wrong, "--data", data)
        assert f"{tmp_path / wrong} is no folder" in said
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["copy.tar", "data"]


def test_repairing_a_station_that_is_not_there_is_refused_and_nothing_is_made(tmp_path: Path) -> None:
    assert f"{tmp_path / 'none'} is not there" in refusal("repair", "--data", tmp_path / "none")
    assert list(tmp_path.iterdir()) == []
