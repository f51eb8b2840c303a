"""`station calibrate`: each module here is one of its commands."""

from __future__ import annotations

import importlib
import pkgutil

import typer


def register(app: typer.Typer) -> None:
    calibrate = typer.Typer(no_args_is_help=True, help="Measure a robot's own sensors.")
    for module in pkgutil.iter_modules(__path__):
        importlib.import_module(f"{__name__}.{module.name}").register(calibrate)
    app.add_typer(calibrate, name="calibrate")
