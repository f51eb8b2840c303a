"""What the demo needs for itself before it starts anything: a port and a folder. Nobody else's are touched."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from shared.disk import lock
from shared.errors import ConfigError
from shared.listening import bind

MARKER = ".sentinel-demo"


def require_free(port: int) -> None:
    """Raise ConfigError when another program, perhaps another demo, listens where the page is to be."""
    try:
        bind("127.0.0.1", port).close()
    except ConfigError as exc:
        raise ConfigError(
            f"port {port} is in use, perhaps by another demo: end that, or take another port with "
            f"--port {port + 1} (make demo PORT={port + 1})"
        ) from exc


@contextmanager
def alone_in(out: Path) -> Iterator[None]:
    """Hold the demo's folder; raises ConfigError while another demo holds it, or when it cannot be used."""
    try:
        out.mkdir(parents=True, exist_ok=True)
        file = (out / ".lock").open("wb")
    except OSError as exc:
        raise ConfigError(f"--out {out} cannot be used: {exc.strerror}") from exc
    with file:
        try:
            is_alone = lock(file, timeout_s=0)
        except OSError as exc:
            raise ConfigError(f"--out {out} cannot be locked: {exc.strerror}; take another folder") from exc
        if not is_alone:
            raise ConfigError(f"another demo runs in {out}: end it, or take another folder with --out")
        yield


def fresh_folder(out: Path) -> Path:
    """The demo's data folder, empty; the run before is kept beside it as `previous`. Others' folders are left alone.

    Raises ConfigError when `out` cannot be used.
    """
    data, previous = out / "data", out / "previous"
    try:
        for folder in (data, previous):
            if folder.exists() and not (folder / MARKER).exists():
                raise ConfigError(f"{folder} was not made by a demo and is left alone: choose another --out")
        if data.exists():
            shutil.rmtree(previous, ignore_errors=True)
            data.rename(previous)
        data.mkdir(parents=True)
        (data / MARKER).write_text("made by station demo; the next demo moves it to `previous`\n")
        (out / "results.json").unlink(missing_ok=True)
    except OSError as exc:
        raise ConfigError(f"--out {out} cannot be used: {exc.strerror}") from exc
    return data
