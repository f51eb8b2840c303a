"""docs/results.md is what `make results` makes of the committed result files, and nothing in it is older than git."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.paths import ROOT

PAGE = ROOT / "docs" / "results.md"
MOST_LINES = 250


def git(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True)


def test_the_page_is_made_of_the_result_files(tmp_path: Path) -> None:
    made = tmp_path / "results.md"
    command = [sys.executable, "-m", "benchmarks.results_page", "--out", str(made)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert made.read_text(encoding="utf-8") == PAGE.read_text(encoding="utf-8"), "run: make results RENDER=1"


def test_the_page_stays_short() -> None:
    assert len(PAGE.read_text(encoding="utf-8").splitlines()) <= MOST_LINES


def test_every_commit_on_the_page_is_part_of_this_history() -> None:
    if git("rev-parse", "--is-shallow-repository").stdout.strip() != "false":
        pytest.skip("no git repository with its whole history: commits cannot be looked up")
    commits = {json.loads(path.read_text())["commit"] for path in (ROOT / "docs" / "results").glob("*.json")}
    assert commits, "no figure was published"
    for commit in commits:
        assert git("merge-base", "--is-ancestor", commit, "HEAD").returncode == 0, f"{commit} is not in this history"


def test_links_into_the_page_find_their_heading() -> None:
    headings = {heading_anchor(line) for line in PAGE.read_text().splitlines() if line.startswith("#")}
    linked = re.compile(r"results\.md#([\w-]+)")
    for path in [ROOT / "README.md", *(ROOT / "docs").glob("**/*.md")]:
        for anchor in linked.findall(path.read_text(encoding="utf-8")):
            assert anchor in headings, f"{path.relative_to(ROOT)} links to results.md#{anchor}, which is not there"


def heading_anchor(line: str) -> str:
    """As GitHub makes it of a heading's text."""
    return re.sub(r"[^\w -]", "", line.lstrip("# ").lower()).replace(" ", "-")
