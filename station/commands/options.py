"""Options that several commands have, and what is checked of them before a command works for minutes."""

from __future__ import annotations

import dataclasses
import os
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar

import typer

from shared.bounded import shown
from shared.errors import ConfigError, DataError
from station.config import StationConfig, check_folder, why_no_path

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

T = TypeVar("T", bound="DataclassInstance")


def parse_folder(given: str | Path) -> Path:
    """What `--data` says, or its default.

    An empty one is a variable of a shell that was never set, not the working directory.
    """
    text = str(given)
    if why := why_no_path(text):
        raise ConfigError(f"--data {shown(text)} is no folder's name ({why}); name the station's data folder")
    return Path(text)


Data = Annotated[
    Path | None,
    typer.Option(
        "--data", parser=parse_folder, metavar="PATH", help="The station's data folder; by default as the config says."
    ),
]
Config = Annotated[Path | None, typer.Option("--config", help="The station's TOML file.")]
Json = Annotated[bool, typer.Option("--json", help="End with one JSON object on stdout.")]
Mode = Annotated[
    Literal["thesis", "default"], typer.Option(help="Of clustering; a navigation is matched as its map was built.")
]
Places = Annotated[
    Literal["rooms", "fine"],
    typer.Option(help="At most six in each room, or every cluster of landmarks (as in thesis mode always)."),
]
AlignBy = Annotated[
    Literal["both", "geometry", "appearance"], typer.Option(help="Default mode: what registration sees.")
]


def data_folder(data: Path | None, settings: StationConfig) -> Path:
    """The station's data folder: `--data`, else what the settings say. Raises ConfigError: it is no folder."""
    return check_folder(settings.data_dir, "data_dir") if data is None else check_folder(data, "--data")


def overridden(settings: T, **options: Any) -> T:
    """Settings with those options over them that were given: None was not."""
    return dataclasses.replace(settings, **{name: value for name, value in options.items() if value is not None})


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


def check_out_file(out: Path) -> None:
    """Whether a file of this name can be written, in a folder that is there, without making it.

    Raises:
        DataError: a folder has the name, or nothing can be made there; says what to do.
    """
    try:
        if out.is_dir():
            raise DataError(f"--out {out} is a folder; give the name of a file")
        if not out.absolute().parent.is_dir():
            raise DataError(f"--out {out}: there is no folder {out.parent}; make it first")
    except OSError as exc:  # too long a name
        raise DataError(f"--out {out} cannot be written ({exc.strerror}); choose another name") from exc
    try:
        with tempfile.TemporaryFile(dir=out.absolute().parent):  # access() says yes to root where nobody can write
            is_free = not out.exists() or os.access(out, os.W_OK)
    except OSError:
        is_free = False
    if not is_free:
        raise DataError(f"--out {out} cannot be written to; choose another folder")
