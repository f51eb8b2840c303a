"""`station`: the program on the PC. Commands live in `station/commands/`, one file each."""

from __future__ import annotations

import typer

from shared.command_line import run_program
from station.commands import (
    access,
    demo,
    doctor,
    experiment,
    export,
    map,
    match,
    recordings,
    register,
    replay,
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
    access,
    demo,
    doctor,
    experiment,
    export,
    map,
    match,
    recordings,
    register,
    replay,
    serve,
    slam,
):
    command.register(app)


def main() -> None:
    """Run one command; a mistake of usage or an error of ours becomes one sentence on stderr."""
    run_program(app, "station")


if __name__ == "__main__":
    main()
