"""`station stickers`: pages that name rooms, to print and hang up."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from shared.errors import DataError
from station.commands.options import Json, check_out_file
from station.files.sticker_page import StickerPage, write_stickers
from station.maps.editing import tidy_name

USUAL_ROOMS = "Living room,Kitchen,Bedroom,Bathroom,Hall,Office"


def register(app: typer.Typer) -> None:
    app.command()(stickers)


def stickers(
    out: Annotated[Path, typer.Option("--out", help="The pages to write, a .pdf.")],
    names: Annotated[str, typer.Option(help="Of the rooms, with commas between them; a page each.")] = USUAL_ROOMS,
    size: Annotated[StickerPage, typer.Option(help="Of the paper.")] = "A4",
    as_json: Json = False,
) -> None:
    """Write stickers that name rooms: a code that the robot reads from 1.5 m and further, the name beneath."""
    if out.suffix.lower() != ".pdf":
        raise DataError(f"--out {out} must end in .pdf")
    check_out_file(out)
    wanted = [tidy_name(name, f'"{name}" in --names') for name in names.split(",")]
    if twice := {name for name in wanted if sum(other.casefold() == name.casefold() for other in wanted) > 1}:
        raise DataError(f'--names has "{sorted(twice)[0]}" twice; each room needs a name of its own')
    write_stickers(wanted, size, out)
    if as_json:
        print(json.dumps({"pages": str(out), "names": wanted, "size": size}))
        return
    print(f"{len(wanted)} pages written to {out}")
    print("print them at 100 % and hang each inside its room, where the robot drives towards it, low on the wall")
