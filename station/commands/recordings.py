"""`station recordings verify` and `station recordings recover`: whether what was recorded is still there."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated

import typer

from shared.errors import DataError
from station.config import load_config

recordings = typer.Typer(no_args_is_help=True, help="Recorded drives on disk.")

Files = Annotated[list[Path] | None, typer.Argument(metavar="[RECORDING]...", help="By default all of the station's.")]
Data = Annotated[Path | None, typer.Option("--data", help="The station's data folder; by default as the config says.")]
Config = Annotated[Path | None, typer.Option("--config", help="The station's TOML file.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout.")]


def register(app: typer.Typer) -> None:
    app.add_typer(recordings, name="recordings")


@recordings.command()
def verify(files: Files = None, data: Data = None, config: Config = None, as_json: Json = False) -> None:
    """Compare every chunk with its checksum. Exit code 1 when something is cut or damaged.

    A recording that a running station is writing has no end yet, and is called cut.
    """
    from station.recording_check import check_recording

    checks = [check_recording(path) for path in files or _all_recordings(data, config)]
    if as_json:
        shown = [
            {"path": str(c.path), "messages": c.messages, "seconds": c.seconds, "bytes": c.size, "damage": c.damage}
            for c in checks
        ]
        print(json.dumps({"recordings": shown}))
    else:
        for check in checks:
            print(check)
        if not checks:
            print("there are no recordings")
    if any(check.damage for check in checks):
        sys.exit(1)


@recordings.command()
def recover(file: Annotated[Path, typer.Argument(help="A recording without its end.")]) -> None:
    """Give a recording that was cut its end again; what is behind the cut is lost."""
    from station.recovery import recover_recording

    if not file.is_file():
        raise DataError(f"{file} is not there; `station recordings verify` lists the station's")
    recovery = recover_recording(file)
    print(f"{file} has its end; nothing was changed" if recovery is None else recovery)


def _all_recordings(data: Path | None, config: Path | None) -> list[Path]:
    root = (data or load_config(config).data_dir) / "navigations"
    if not root.is_dir():
        raise DataError(f"{root} is not there; name the station's data folder with --data")
    return sorted(root.glob("*/recording.mcap"))
