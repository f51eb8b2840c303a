"""How much memory a reader takes, in a process of its own that dies before it harms the machine."""

from __future__ import annotations

import importlib
import json
import resource
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from shared.errors import RobotSystemError
from tests.support.paths import ROOT

MB = 1024 * 1024
HARMLESS = 2048 * MB  # of address space, beyond what the libraries take


@dataclass(frozen=True)
class Reading:
    """What became of a file that was read."""

    refused: str  # the sentence; empty: it was read
    result: str
    grown_mb: float  # of resident memory, at its peak


def read_in_child(reader: str, *paths: Path) -> Reading:
    """Call `module:function` with these paths. Fails with the child's traceback where it ends in one."""
    done = subprocess.run(
        [sys.executable, "-m", "tests.support.child_memory", reader, *map(str, paths)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=240,
    )
    assert done.returncode == 0, done.stderr
    return Reading(**json.loads(done.stdout.splitlines()[-1]))


def main(reader: str, *paths: str) -> None:
    module, _, function = reader.partition(":")
    call = getattr(importlib.import_module(module), function)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + HARMLESS, used + HARMLESS))
    refused = result = ""
    try:
        result = repr(call(*map(Path, paths)))[:1000]
    except RobotSystemError as exc:
        refused = str(exc)
    grown_mb = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024
    print(json.dumps({"refused": refused, "result": result, "grown_mb": grown_mb}))


if __name__ == "__main__":
    main(*sys.argv[1:])
