"""`station calibrate target`: what is written, and what is refused in a sentence."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from station.calibration.target_file import read_target
from tests.support.paths import ROOT


def calibrate_target(*options: str) -> subprocess.CompletedProcess[str]:
    words = [sys.executable, "-m", "station.main", "calibrate", "target", *options]
    return subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=False)


@pytest.mark.parametrize("kind", ["aprilgrid", "charuco", "chessboard"])
def test_page_and_description_are_written(kind: str, tmp_path: Path) -> None:
    page = tmp_path / "target.pdf"
    done = calibrate_target("--kind", kind, "--size", "Letter", "--out", str(page), "--json")
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout.splitlines()[-1])
    assert page.read_bytes().startswith(b"%PDF") and b"/Subtype /Image" not in page.read_bytes()  # vectors only
    target = read_target(Path(report["target"]))
    assert (target.kind, target.square_m) == (kind, report["square_m"])


def test_what_cannot_be_written_is_refused_in_a_sentence(tmp_path: Path) -> None:
    for options, words in (
        (("--out", str(tmp_path / "target.png")), "must end in .pdf"),
        (("--out", str(tmp_path / "nowhere" / "target.pdf")), "make it first"),
        (("--out", str(tmp_path / "target.pdf"), "--columns", "50"), "take fewer or larger paper"),
    ):
        done = calibrate_target(*options)
        assert done.returncode != 0 and words in done.stderr and "Traceback" not in done.stderr
    assert not list(tmp_path.iterdir())


def test_lengths_that_somebody_measured_are_not_overwritten(tmp_path: Path) -> None:
    page, description = tmp_path / "target.pdf", tmp_path / "target.yaml"
    assert calibrate_target("--out", str(page)).returncode == 0
    assert calibrate_target("--out", str(page)).returncode == 0  # the same page again
    corrected = description.read_text().replace("tagSize: 0.027 ", "tagSize: 0.0265 ")
    assert corrected != description.read_text()
    description.write_text(corrected)
    page.unlink()
    done = calibrate_target("--out", str(page))
    assert done.returncode == 1 and f"{description} is there already" in done.stderr
    assert description.read_text() == corrected and not page.exists()
