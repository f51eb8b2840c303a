"""`robot-sim`: datasets from the simulated robot, renderings along a given path, a scripted driver, pictures."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from robot.simulation.calibration.kind import Kind
from robot.simulation.config import SimulationConfig, load_config, without_imperfections
from shared.command_line import run_program
from shared.errors import ConfigError

app = typer.Typer(name="robot-sim", no_args_is_help=True, add_completion=False, pretty_exceptions_enable=False)

WorldOption = Annotated[str, typer.Option(help="home, small, lookalike, plain, corner, large, room, vicon or checker")]
SeedOption = Annotated[int, typer.Option(min=0, help="which world of that kind")]
ConfigOption = Annotated[Path | None, typer.Option(help="TOML file with imperfections and faults")]
IdealOption = Annotated[bool, typer.Option(help="switch every imperfection of sensors and floor off")]


@app.callback()
def robot_sim() -> None:
    """The simulated robot: furnished flats from a seed, a skid-steer body, camera and IMU with their faults."""


def effective_config(path: Path | None, no_imperfections: bool) -> SimulationConfig:
    config = load_config(path) if path else SimulationConfig()
    return without_imperfections(config) if no_imperfections else config


class Progress:
    """A percentage on stderr, only on a terminal."""

    def __init__(self) -> None:
        self._shown = -1

    def __call__(self, share: float) -> None:
        percent = int(100 * share)
        if percent != self._shown and sys.stderr.isatty():
            print(f"\r{percent:3d} %", end="" if percent < 100 else "\n", file=sys.stderr, flush=True)
            self._shown = percent


@app.command()
def dataset(
    out: Annotated[Path, typer.Option(help="folder to write, must not exist")],
    world: WorldOption = "home",
    seed: SeedOption = 0,
    route: Annotated[
        str, typer.Option(help="mapping, second, local, tour, triangle_a, triangle_b or triangle_c")
    ] = "mapping",
    drive_seed: Annotated[int, typer.Option(min=0, help="noise, slip and small differences of this drive")] = 0,
    put_down: Annotated[
        int | None, typer.Option(min=0, help="start at the random spot of this seed, as after a hijack")
    ] = None,
    fps: Annotated[float | None, typer.Option(help="frames per second")] = None,
    config: ConfigOption = None,
    no_imperfections: IdealOption = False,
    max_duration: Annotated[float, typer.Option(help="stop after this many seconds")] = 600.0,
    look_around: Annotated[
        float | None, typer.Option(min=1, max=80, help="turn the head so many degrees to both sides on the way")
    ] = None,
) -> None:
    """Drive a route and write an EuRoC/ASL folder with images, IMU, truth and drive commands."""
    import math
    import time

    import msgspec

    from robot.simulation.atlas import default_cache_dir
    from robot.simulation.driver import LookAround
    from robot.simulation.recording import record_drive
    from robot.simulation.routes import FreeSpace, plan_route
    from robot.simulation.worlds import make_world

    settings = effective_config(config, no_imperfections)
    if fps is not None:
        settings = msgspec.structs.replace(settings, camera_rate_hz=fps)
    flat = make_world(world, seed, settings)
    spot = None if put_down is None else FreeSpace(flat, settings.body.radius_m).random_spot(put_down)
    plan = plan_route(flat, route, drive_seed, settings.body.radius_m, start=spot[:2] if spot else None)
    yaw = spot[2] if spot else None
    began = time.monotonic()
    looking = None if look_around is None else LookAround(math.radians(look_around))
    kept, shown = default_cache_dir(), Progress()
    result = record_drive(flat, plan, settings, drive_seed, out, kept, shown, max_duration, yaw, looking)
    wall_s = time.monotonic() - began
    state = "finished" if result.route_done else "not finished"
    print(
        f"{out}: {result.frames} frames, {result.duration_s:.1f} s, path {result.path_m:.1f} m, route {state}, "
        f"blocked {result.blocked_s:.1f} s, rooms: {', '.join(result.rooms)}; "
        f"{result.duration_s / wall_s:.1f}x real time"
    )


@app.command()
def along(
    states: Annotated[Path, typer.Argument(help="CSV of true states (state_groundtruth_estimate0/data.csv)")],
    camera: Annotated[Path, typer.Option(help="sensor.yaml; a data.csv beside it gives the frame stamps")],
    out: Annotated[Path, typer.Option(help="folder to write, must not exist")],
    imu: Annotated[Path | None, typer.Option(help="folder of a recorded IMU to copy; without it one is made")] = None,
    world: WorldOption = "vicon",
    seed: SeedOption = 0,
    start: Annotated[float, typer.Option(help="seconds after the first state")] = 0.0,
    duration: Annotated[float, typer.Option(help="seconds")] = float("inf"),
    config: ConfigOption = None,
    no_imperfections: IdealOption = False,
) -> None:
    """Render the world along a recorded path and write an EuRoC/ASL folder."""
    from robot.simulation.along import render_along
    from robot.simulation.atlas import default_cache_dir
    from robot.simulation.worlds import make_world

    settings = effective_config(config, no_imperfections)
    flat, kept, shown = make_world(world, seed, settings), default_cache_dir(), Progress()
    frames = render_along(flat, states, camera, imu, out, settings, seed, start, duration, kept, shown)
    print(f"{out}: {frames} frames")


@app.command()
def calibration(
    out: Annotated[Path, typer.Option(help="folder to write, must not exist")],
    kind: Annotated[Kind, typer.Option(help="what the recording shall calibrate")] = Kind.CAMERA_IMU,
    seed: Annotated[int, typer.Option(min=0, help="another robot, board, motion and noise")] = 0,
    poor: Annotated[str | None, typer.Option(help="a mistake of the user, by name (docs/simulator.md)")] = None,
    seconds: Annotated[float | None, typer.Option(min=1.0, max=86400.0, help="how long")] = None,
    motors: Annotated[bool, typer.Option(help="kind imu: the motors run and shake the sensor")] = False,
) -> None:
    """Record what calibrates a robot: a board moved before its camera, the robot waved before a board, or its IMU."""
    from robot.simulation.calibration.sessions import record_session

    session = record_session(kind, out, seed, poor, seconds, motors, Progress())
    print(f"{out}: {session.frames} frames, {session.imu_samples} IMU samples")


@app.command()
def drive(
    station: Annotated[str, typer.Option(help="address of the station, http://HOST:PORT")],
    sim_port: Annotated[int, typer.Option(help="the simulator's control port (robot-server --sim-port)")],
    route: Annotated[str, typer.Option(help="mapping, second, local, tour or triangle_a|b|c")] = "mapping",
    seed: Annotated[int, typer.Option(min=0, help="another route of the same kind")] = 0,
    driver: Annotated[str, typer.Option(help="name under which to hold the driver lease")] = "scripted",
    max_duration: Annotated[float, typer.Option(help="give up after this many seconds")] = 600.0,
    pace: Annotated[str, typer.Option(help="calm or brisk")] = "calm",
) -> None:
    """Drive a running simulated robot along a route through the station's drive commands."""
    from robot.simulation.driver import PACES
    from robot.simulation.remote_driver import drive_route

    if pace not in PACES:
        raise ConfigError(f"pace {pace!r} is unknown; choose one of {', '.join(PACES)}")
    report = drive_route(station, sim_port, route, seed, driver, max_duration, PACES[pace])
    print(f"{route}: {report.length_m:.1f} m in {report.duration_s:.1f} s, {report.refused} commands refused")


@app.command()
def view(
    out: Annotated[Path, typer.Option(help="PNG file to write")],
    world: WorldOption = "home",
    seed: SeedOption = 0,
    config: ConfigOption = None,
) -> None:
    """Write a contact sheet: the floor plan with the mapping route, and what the camera sees in each room."""
    from robot.simulation.atlas import default_cache_dir
    from robot.simulation.contact_sheet import draw_contact_sheet
    from robot.simulation.worlds import make_world

    settings = effective_config(config, False)
    draw_contact_sheet(make_world(world, seed, settings), settings, out, default_cache_dir())
    print(out)


def main() -> None:
    """Run one command; a mistake of usage or an error of ours becomes one sentence on stderr."""
    run_program(app, "robot-sim")


if __name__ == "__main__":
    main()
