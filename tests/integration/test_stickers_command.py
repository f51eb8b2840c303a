"""`station stickers`: pages are written, and what cannot be is refused in a sentence."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.paths import ROOT


def stickers(*options: str) -> subprocess.CompletedProcess[str]:
    words = [sys.executable, "-m", "station.main", "stickers", *options]
    return subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=False)


@pytest.mark.computing
def test_a_page_for_each_name_is_written_as_vectors(tmp_path: Path) -> None:
    out = tmp_path / "stickers.pdf"
    done = stickers("--out", str(out), "--names", "Kitchen, Schlafzimmer Süd", "--size", "Letter", "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["names"] == ["Kitchen", "Schlafzimmer Süd"]
    page = out.read_bytes()
    assert page.startswith(b"%PDF") and b"/Count 2" in page and b"/Subtype /Image" not in page


@pytest.mark.computing
def test_what_cannot_be_printed_is_refused_in_a_sentence(tmp_path: Path) -> None:
    out = str(tmp_path / "stickers.pdf")
    for options, words in (
        (("--out", str(tmp_path / "stickers.png")), "must end in .pdf"),
        (("--out", out, "--names", "Bath,bath"), "twice"),
        (("--out", out, "--names", "Bath,,Hall"), "needs 1 to 80 characters"),
        (("--out", out, "--names", "x" * 60), "shorten it"),
        (("--out", out, "--names", "Bath,厨房"), 'has no "厨房"'),
    ):
        done = stickers(*options)
        assert done.returncode != 0 and words in done.stderr and "Traceback" not in done.stderr
    assert not list(tmp_path.iterdir())
