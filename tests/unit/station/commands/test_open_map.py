"""What a command takes for a map: a folder with a map in it, or the id of one that the station keeps."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from shared.errors import DataError
from station.commands.map_store import open_map
from station.main import app
from station.maps.folder import save_map_folder
from station.maps.store import MapStore
from tests.support.places import make_map


def test_a_folder_that_happens_to_have_the_id_of_a_map_is_not_taken_for_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    MapStore(tmp_path / "data" / "maps").save(make_map("flat"))
    Path("flat").mkdir()
    assert open_map("flat", tmp_path / "data", None).id == "flat"
    with pytest.raises(DataError, match="holds no map"):
        open_map(str(tmp_path / "flat"), tmp_path / "data", None)
    save_map_folder(make_map("attic"), Path("flat"))
    assert open_map("flat", tmp_path / "data", None).id == "attic"


@pytest.mark.parametrize(
    "command",
    [
        "map rooms flat",
        "map show flat",
        "map undo flat",
        "map delete flat",
        "map history flat",
        "export flat --format floorplan --out plan.svg",
    ],
)
def test_where_the_default_folder_has_no_such_map_the_sentence_names_the_option(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: str
) -> None:
    monkeypatch.chdir(tmp_path)
    for named in ("", "elsewhere"):
        result = CliRunner().invoke(app, [*command.split(), *(["--data", named] if named else [])])
        assert isinstance(result.exception, DataError) and 'holds no map "flat"' in str(result.exception)
        assert ("--data" in str(result.exception)) is (not named)
