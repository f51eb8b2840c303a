"""`station doctor`: what is missing on this machine, in sentences."""

from __future__ import annotations

import importlib.util
import platform
import sys

import typer

# module → what it is for, how to get it
PARTS = {
    "cv2": ("images and feature tracking", "pip install '.[station]' in Sentinel's folder"),
    "pycolmap": ("structure from motion (--backend sfm)", "pip install '.[station]' on an x86_64 PC"),
    "small_gicp": ("registration of point clouds", "pip install '.[station]' in Sentinel's folder"),
    "kiss_matcher": ("global registration; our own search is used without it", "Python 3.11 or 3.12 on x86_64"),
    "fastapi": ("the API and the page", "pip install '.[station]' in Sentinel's folder"),
    "mcap": ("recordings", "pip install '.[station]' in Sentinel's folder"),
    "open3d": (
        "optional second registration backend",
        "pip install '.[open3d]' in Sentinel's folder and apt install libgl1 libx11-6",
    ),
}


def register(app: typer.Typer) -> None:
    app.command()(doctor)


def doctor() -> None:
    """Say what is missing on this machine, and how to get it."""
    print(f"Python {platform.python_version()} on {platform.machine()}, {sys.platform}")
    for module, (purpose, remedy) in PARTS.items():
        if importlib.util.find_spec(module):
            print(f"  ok       {module}: {purpose}")
        else:
            print(f"  missing  {module}: {purpose}. Remedy: {remedy}")
