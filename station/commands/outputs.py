"""Where a command will write is looked at before it works for minutes."""

from __future__ import annotations

import os
from pathlib import Path

from shared.errors import DataError


def check_out_folder(out: Path) -> None:
    """Whether a folder of this name can be written, without making it.

    Raises:
        DataError: a file has the name, or it cannot be made there; says what to do.
    """
    nearest = out.absolute()
    try:
        while not nearest.exists():
            nearest = nearest.parent
    except OSError as exc:  # too long a name
        raise DataError(f"--out {out} cannot be written ({exc.strerror}); choose another folder") from exc
    if not nearest.is_dir():
        raise DataError(f"--out {out}: {nearest} is a file; choose another folder")
    if not os.access(nearest, os.W_OK | os.X_OK):
        raise DataError(f"--out {out}: {nearest} cannot be written to; choose another folder")
