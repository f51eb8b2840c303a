"""`robot-server`: the program on the robot."""

from __future__ import annotations

import logging
import sys
from pathlib import Path
from typing import Annotated, Literal

import typer

from shared.command_line import run_program
from shared.repetition import start_logging

cli = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@cli.command()
def serve(
    devices: Annotated[
        Literal["simulated", "recorded", "pi"],
        typer.Option(help="Real, simulated or recorded hardware; chosen, never guessed."),
    ],
    world: Annotated[str | None, typer.Option(help="Simulated world.")] = None,
    seed: Annotated[int | None, typer.Option(help="Seed of the simulated world.")] = None,
    sim_port: Annotated[int | None, typer.Option(help="Port of the simulator's truth, for tests and the demo.")] = None,
    imu: Annotated[
        Literal["simulated", "emulated"] | None, typer.Option(help="emulated: the real firmware in an emulated Mega.")
    ] = None,
    dataset: Annotated[
        Path | None, typer.Option(help="Recorded drive: ASL folder, folder of images, video or MCAP file.")
    ] = None,
    speed: Annotated[float | None, typer.Option(help="Play a recording so many times as fast.")] = None,
    at_end: Annotated[Literal["stop", "loop"] | None, typer.Option(help="When the recording is over.")] = None,
    host: Annotated[str | None, typer.Option(help="Address to listen on; 0.0.0.0 lets the network in.")] = None,
    port: Annotated[int | None, typer.Option(help="Port to listen on; 0 takes a free one.")] = None,
    config: Annotated[Path | None, typer.Option(help="TOML file; options override it.")] = None,
    check: Annotated[bool, typer.Option("--check", help="Test each part in turn, say what is wrong, and end.")] = False,
    insecure: Annotated[
        bool, typer.Option("--insecure", help="No access control: whoever reaches the port can watch and drive.")
    ] = False,
    verbose: Annotated[bool, typer.Option("--verbose", help="Log what happens.")] = False,
) -> None:
    """Serve this robot's camera, IMU and motors to stations.

    Who may connect: robot-server access --help; a code for a new station: robot-server pair (docs/access.md).
    """
    from robot import app  # numpy and the network's libraries: `--help` does without them
    from robot.config import load_config

    start_logging(logging.INFO if verbose else logging.WARNING, "robot-server: %(levelname)s: %(message)s")
    settings = load_config(
        config,
        {
            "server": {"host": host, "port": port},
            "access": {"insecure": insecure or None},
            "simulated": {"world": world, "seed": seed, "sim_port": sim_port, "imu": imu},
            "recorded": {"dataset": dataset and str(dataset), "speed": speed, "at_end": at_end},
        },
    )
    if check:
        raise typer.Exit(0 if app.check(devices, settings) else 1)
    app.run(devices, settings)


def main() -> None:
    """Run one command; a mistake of usage or an error of ours becomes one sentence on stderr."""
    # Subcommands beside a program that is a command itself: `robot-server --devices …` stays as it is.
    if sys.argv[1:2] in (["access"], ["pair"]):
        from robot.access_commands import cli as access_cli

        run_program(access_cli, "robot-server")
    else:
        run_program(cli, "robot-server")


if __name__ == "__main__":
    main()
