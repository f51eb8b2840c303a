"""What the `[robot]` extra brings to a 64-bit Pi: every package must have a wheel there, and none may be heavy.

    python -m benchmarks.check_robot_wheels [--results FILE]

Resolves with pip for aarch64 and the Pi OS Pythons (bookworm 3.11, trixie 3.13) beside the numpy that Debian has there
(robot/install.sh keeps it); downloads into a temporary folder.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path
from typing import Any

from benchmarks.result import Figure, Run, add_results_option
from tests.support.debian import DEBIAN_NUMPY
from tests.support.paths import ROOT

HEAVY = {"open3d", "scipy", "pycolmap", "scikit-learn", "opencv-python-headless", "matplotlib"}
PLATFORMS = [f"manylinux_2_{minor}_aarch64" for minor in (17, 24, 26, 27, 28, 31, 34)] + ["manylinux2014_aarch64"]


def check(python: str, requirements: list[str]) -> dict[str, Any]:
    """Wheels and their size for one Python. Raises CalledProcessError where one has no wheel."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "pip", "download", "--quiet", "--disable-pip-version-check"]
        command += ["--only-binary=:all:", "--python-version", python, "--implementation", "cp", "-d", folder]
        for platform in PLATFORMS:
            command += ["--platform", platform]
        run = subprocess.run([*command, *requirements], capture_output=True, text=True)
        if run.returncode != 0:
            raise SystemExit(f"python {python} on aarch64: {run.stderr.strip().splitlines()[-1]}")
        wheels = sorted(Path(folder).glob("*.whl"))
        names = {w.name.split("-")[0].replace("_", "-").lower() for w in wheels}
        if names & HEAVY:
            raise SystemExit(f"python {python}: the robot would get {sorted(names & HEAVY)}")
        size_mb = sum(w.stat().st_size for w in wheels) / 1e6
        return {"python": python, "wheels": [w.name for w in wheels], "megabytes": round(size_mb, 1)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add_results_option(parser, "robot_wheels")
    options = parser.parse_args()
    run = Run.begin()
    figures = []
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    requirements = project["dependencies"] + project["optional-dependencies"]["robot"]
    for python, numpy in DEBIAN_NUMPY.items():
        found = check(python, [*requirements, f"numpy=={numpy}"])
        print(json.dumps(found, indent=1))
        wheels = len(found["wheels"])
        what = f"packages that a Pi downloads for Python {python}, all as wheels for aarch64"
        figures.append(Figure(what, found["megabytes"], "MB", of=wheels))
    run.write(options.results, figures)


if __name__ == "__main__":
    main()
