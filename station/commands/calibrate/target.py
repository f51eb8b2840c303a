"""`station calibrate target`: a board to print."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from shared.errors import DataError
from station.calibration.target import TargetKind
from station.calibration.target_file import target_yaml
from station.calibration.target_page import PageSize, page_target, write_page
from station.commands.options import Json, check_out_file


def register(app: typer.Typer) -> None:
    app.command()(target)


def target(
    out: Annotated[
        Path, typer.Option("--out", help="The page to write, a .pdf; its target.yaml is written beside it.")
    ],
    kind: Annotated[TargetKind, typer.Option(help="Which board; an aprilgrid may be partly hidden.")] = "aprilgrid",
    size: Annotated[PageSize, typer.Option(help="Of the paper.")] = "A4",
    columns: Annotated[int | None, typer.Option(min=2, max=50, help="Tags, or inner corners, in a row.")] = None,
    rows: Annotated[int | None, typer.Option(min=2, max=50, help="Tags, or inner corners, in a column.")] = None,
    as_json: Json = False,
) -> None:
    """Write a calibration target as a page to print, with a ruler, and the target.yaml that describes it."""
    if out.suffix.lower() != ".pdf":
        raise DataError(f"--out {out} must end in .pdf")
    check_out_file(out)
    description = out.with_suffix(".yaml")
    check_out_file(description)
    board = page_target(kind, size, columns, rows)
    described = target_yaml(board)
    if description.exists() and description.read_bytes() != described.encode("utf-8"):
        raise DataError(
            f"{description} is there already and says something else, perhaps lengths that somebody measured;"
            " choose another name with --out, or remove it"
        )
    write_page(board, size, out)
    description.write_text(described, encoding="utf-8")
    if as_json:
        print(json.dumps({"page": str(out), "target": str(description), "kind": kind, "square_m": board.square_m}))
        return
    print(f"written to {out} and {description}")
    print("print the page at 100 % and measure its ruler: 100 mm, else correct the lengths in the .yaml")
