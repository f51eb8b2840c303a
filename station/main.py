"""`station`: the program on the PC. Commands live in `station/commands/`; each is imported when it is called.

The libraries of estimation take seconds and hundreds of megabytes to import: only the command that needs them waits.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

import typer
from typer.core import TyperCommand, TyperGroup
from typer.main import get_group

from shared.command_line import run_program

if TYPE_CHECKING:  # Typer carries its own copy of Click, whose classes have no public names
    from typer._click import Command, Context

# Command → its module in station.commands, and what `station --help` says of it.
COMMANDS = {
    "pair": ("access", "Pair with a robot: its code becomes a token, and its certificate is remembered."),
    "robots": ("access", "The robots this station is paired with."),
    "calibrate": ("calibrate", "Print a target, and measure a robot's own sensors with it."),
    "demo": ("demo", "Simulated robot, robot-server and station: map, hijack, drive again, and name the place."),
    "doctor": (
        "doctor",
        "Say what is missing on this machine, and how to get it. Exit code 1 when the station cannot work without it.",
    ),
    "evaluate": (
        "evaluate",
        "Compare a navigation with true poses: ATE, RPE over 1 s, orientation, scale, coverage, and figures over time.",
    ),
    "experiment": (
        "experiment",
        "Map one navigation, find its places again in another, and judge the matches where true poses were recorded.",
    ),
    "export": (
        "export",
        "Write trajectory (tum, euroc), cloud (ply), place graph (graphml), COLMAP model, or all for Foxglove (mcap).",
    ),
    "locate": ("locate", "Ask over recorded data, as the live station does, which place of a map the robot is at."),
    "match": ("match", "Register a navigation to a map, match its locations with the places, and write a report."),
    "register": (
        "register",
        "Register SOURCE to TARGET without a guess; exit code 0 only when the result is accepted.",
    ),
    "replay": (
        "replay",
        "Reconstruct, map and ask for the current place, as the running station would; prints a hash of each result.",
    ),
    "serve": ("serve", "Serve the page and the API: drive, map, and ask which place the robot is at."),
    "stickers": (
        "stickers",
        "Write stickers that name rooms: a code that the robot reads from 1.5 m and further, the name beneath.",
    ),
    "labels": (
        "labels",
        "Suggest names for a map's rooms by a model of yours: each view votes. Nothing is named until you accept it.",
    ),
    "slam": ("slam", "Reconstruct trajectory and landmarks of one recorded navigation."),
    "access": ("access", "Who may use this station."),
    "map": ("map", "Places, their graph and their names."),
    "recordings": ("recordings", "Recordings on disk."),
}


class ImportedWhenCalled(TyperGroup):
    """Lists commands by their names and help alone; imports the module of the one that is called."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        for name, (_, text) in COMMANDS.items():
            self.add_command(TyperCommand(name, help=text))

    def resolve_command(self, ctx: Context, args: list[str]) -> tuple[str | None, Command | None, list[str]]:
        name, _, rest = super().resolve_command(ctx, args)
        return name, None if name is None else load_command(name), rest


def load_command(name: str) -> Command:
    """Import the command with all its options."""
    module, _ = COMMANDS[name]
    commands = typer.Typer()
    importlib.import_module(f"station.commands.{module}").register(commands)
    return get_group(commands).commands[name]


app = typer.Typer(
    name="station",
    cls=ImportedWhenCalled,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)


@app.callback()
def station() -> None:
    """Receives a robot's camera and IMU, maps places, and answers which place the robot is at."""


def main() -> None:
    """Run one command; a mistake of usage or an error of ours becomes one sentence on stderr."""
    run_program(app, "station")


if __name__ == "__main__":
    main()
