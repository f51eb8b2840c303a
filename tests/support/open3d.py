"""Open3D, the second library of the GICP step: an extra that loads libraries of the system."""

from __future__ import annotations

import functools
import importlib.util
import subprocess
import sys

import pytest


@functools.cache
def why_no_open3d() -> str:
    """Why it cannot be used here; "" where it can. Tried in another process: a failed import leaves halves behind."""
    if importlib.util.find_spec("open3d") is None:
        return "open3d is not installed; run: scripts/open3d-need.sh"
    tried = subprocess.run([sys.executable, "-W", "ignore", "-c", "import open3d"], capture_output=True, text=True)
    if tried.returncode == 0:
        return ""
    [*_, last] = tried.stderr.strip().splitlines() or ["it ended without a word"]
    return f"open3d cannot be loaded ({last}); run: scripts/open3d-need.sh"


def skip_without_open3d() -> None:
    """Skips the test that calls it where Open3D cannot be used, and says what is missing."""
    if why := why_no_open3d():
        pytest.skip(why)
