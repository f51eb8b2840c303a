"""Where the localisation index of a map is kept. Whoever only removes one need not import what reads it."""

from __future__ import annotations

import contextlib
from pathlib import Path

FOLDER = "localisation"  # beside the maps
SUFFIX = ".index"


def index_path(root: Path, map_id: str) -> Path:
    """The file of a map of the store at `root`."""
    return root / FOLDER / f"{map_id}{SUFFIX}"


def forget_index(root: Path, map_id: str) -> None:
    """A map is gone for good, and with it what was made of its pictures."""
    with contextlib.suppress(OSError):
        index_path(root, map_id).unlink(missing_ok=True)
