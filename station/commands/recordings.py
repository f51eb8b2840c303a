"""`station recordings verify` and `station recordings recover`: whether what was recorded is still there."""

from __future__ import annotations

import json
import stat
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

from shared.bounded import shortened
from shared.errors import DataError
from station.commands.options import Config, Data, Json, data_folder
from station.config import load_config

recordings = typer.Typer(no_args_is_help=True, help="Recordings on disk.")

Files = Annotated[list[Path] | None, typer.Argument(metavar="[RECORDING]...", help="By default all of the station's.")]


def register(app: typer.Typer) -> None:
    app.add_typer(recordings, name="recordings")


@recordings.command()
def verify(files: Files = None, data: Data = None, config: Config = None, as_json: Json = False) -> None:
    """Compare chunks and index with their checksums. Exit code 1 when something is cut, damaged or cannot be read.

    A recording that is being written has no end yet, which is no damage.
    """
    from station.commands.progress import working
    from station.recordings.check import check_recording

    paths = files or _all_recordings(data, config)
    shown: list[dict[str, Any]] = []
    is_damaged = False
    for number, path in enumerate(paths, 1):
        with working(f"{path} ({number} of {len(paths)})"):  # while it shows, it takes what is printed
            check = check_recording(path)
        is_damaged = is_damaged or bool(check.damage)
        if not as_json:
            print(check, flush=True)
        shown.append(asdict(check))
    if as_json:
        print(json.dumps({"recordings": shown}, default=str))
    elif not paths:
        print("there are no recordings")
    if is_damaged:
        sys.exit(1)


@recordings.command()
def recover(file: Annotated[Path, typer.Argument(help="A recording that is cut or damaged.")]) -> None:
    """Make a cut or damaged recording a proper file of everything in it that is sound.

    When more than a cut end was lost, the file as it was is kept beside it as FILE.damaged.
    """
    from station.commands.progress import working
    from station.recordings.recovery import recover_recording

    _check_file(file)
    with working(str(file)):
        recovery = recover_recording(file)
    print(f"{file} is whole; nothing was changed" if recovery is None else recovery)


def _check_file(path: Path) -> None:
    """Raises DataError: it is no file, and what it is instead."""
    try:
        mode = path.stat().st_mode
    except FileNotFoundError as exc:
        raise DataError(f"{path} is not there; `station recordings verify` lists the station's") from exc
    except OSError as exc:
        raise DataError(f"{shortened(str(path))} cannot be read ({exc.strerror}); name a recording") from exc
    if not stat.S_ISREG(mode):
        what = "a folder" if stat.S_ISDIR(mode) else "a pipe or a device"
        raise DataError(f"{path} is {what}, no recording; `station recordings verify` lists the station's")


def _all_recordings(data: Path | None, config: Path | None) -> list[Path]:
    root = data_folder(data, load_config(config)) / "navigations"
    if not root.is_dir():
        raise DataError(f"{root} is not there; name the station's data folder with --data")
    return sorted(root.glob("*/recording.mcap"))
