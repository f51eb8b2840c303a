"""What docs and comments point to is there."""

import re
import subprocess
from pathlib import Path

from tests.support.paths import ROOT

PATH = re.compile(
    r"(?<![\w/.-])(?:station|robot|shared|tests|benchmarks|scripts|firmware|docker|examples|docs)/[\w/.-]+\.\w+"
)
FROZEN = ("docs/studies/", "docs/results")  # what was measured once, where it lay then
MADE = (
    "station/web/dist",
    "station/web/node_modules",
    "station/web/src/api-types.ts",
    "benchmarks/results/",
    "docs/results/",
    "firmware/build/",
)


def test_no_file_is_a_link() -> None:
    listed = subprocess.run(["git", "ls-files", "-s"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    entries = listed.splitlines()
    assert len(entries) > 100
    assert not [entry for entry in entries if entry.startswith("120000")]


def test_every_file_that_is_named_exists() -> None:
    tracked = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout.split()
    texts = [name for name in tracked if name.endswith((".md", ".py", ".ts", ".sh")) and not name.startswith(FROZEN)]
    assert len(texts) > 100
    missing = {
        f"{name}: {named}"
        for name in texts
        for named in PATH.findall(Path(ROOT, name).read_text())
        if not Path(ROOT, named).exists() and not named.startswith(MADE)
    }
    assert not missing
