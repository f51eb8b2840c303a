"""`station`: the program on the PC. Commands live in `station/commands/`, one file each."""

from __future__ import annotations

import sys

import typer

from shared.errors import RobotSystemError
from station.commands import (
    demo,
    doctor,
    experiment,
    export,
    map,
    match,
    register,
    serve,
    slam,
)

app = typer.Typer(
    name="station",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)


@app.callback()
def station() -> None:
    """Receives a robot's camera and IMU, maps places, and answers which place the robot is at."""


for command in (
    demo,
    doctor,
    experiment,
    export,
    map,
    match,
    register,
    serve,
    slam,
):
    command.register(app)


def main() -> None:
    """Run one command; an error of ours becomes one sentence on stderr and exit code 1."""
    try:
        app()
    except RobotSystemError as exc:
        print(f"station: {exc}", file=sys.stderr)
        sys.exit(1)


if __name__ == "__main__":
    main()
