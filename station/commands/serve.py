"""`station serve`: the running station with its API and page."""

from __future__ import annotations

import asyncio
import logging
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from shared.certificates import show_fingerprint
from shared.listening import bind, show_address
from shared.long_lived import keep_for_good
from shared.repetition import start_logging
from station.commands.options import data_folder, overridden, parse_folder
from station.config import (
    DEFAULT_DATA_DIR,
    ApiConfig,
    RobotConfig,
    SlamConfig,
    StationConfig,
    check_backend,
    load_config,
    parse_robot,
)

ROBOT_WITHIN_S = 3.0  # then it is said why there is none; a name may be mistyped


def register(app: typer.Typer) -> None:
    app.command()(serve)


def serve(
    robot: Annotated[
        list[str] | None,
        typer.Option(
            metavar="[NAME=]HOST:PORT",
            help="Where robot-server is; auto looks for one in the network. Give it once for each of several robots.",
            show_default=f"{RobotConfig().host}:{RobotConfig().port}",
        ),
    ] = None,
    host: Annotated[
        str | None,
        typer.Option(help="Address to serve on; 0.0.0.0 lets the network in.", show_default=ApiConfig().host),
    ] = None,
    port: Annotated[
        int | None,
        typer.Option(
            min=0, max=65535, help="Port to serve on; 0 takes a free one.", show_default=str(ApiConfig().port)
        ),
    ] = None,
    data: Annotated[
        Path | None,
        typer.Option(
            parser=parse_folder,
            metavar="PATH",
            help="Folder for navigations and maps.",
            show_default=str(DEFAULT_DATA_DIR),
        ),
    ] = None,
    backend: Annotated[
        str | None,
        typer.Option(help="SLAM while recording: auto, ukf, smoothing, sfm, mono.", show_default=SlamConfig().backend),
    ] = None,
    config: Annotated[Path | None, typer.Option(help="TOML file; options override it.", show_default="none")] = None,
    executor: Annotated[
        str | None,
        typer.Option(help="Where jobs compute: dask://HOST:PORT of a scheduler.", show_default="this machine"),
    ] = None,
    insecure: Annotated[
        bool, typer.Option("--insecure", help="No access control: whoever reaches the port can watch and drive.")
    ] = False,
    verbose: Annotated[bool, typer.Option("--verbose", help="Log what happens.")] = False,
) -> None:
    """Serve the page and the API: drive, map, and ask which place the robot is at."""
    from station.api.server import make_api
    from station.api.serving import serve_until_signal
    from station.app import Station  # the web and estimation libraries load only for this command
    from station.workers.scheduling import request_short_slices

    start_logging(logging.INFO if verbose else logging.WARNING, "station: %(levelname)s: %(message)s")
    settings = _settings(load_config(config), robot, host, port, data, backend, insecure, executor)
    listener = bind(settings.api.host, settings.api.port)
    with listener:
        name, number = listener.getsockname()[:2]
        station = Station(settings)
        identity = station.access.identity
        scheme = "http" if identity is None else "https"
        address = f"{scheme}://{show_address(name, number)}"

        def started() -> None:
            keep_for_good()
            print(f"station: page and API at {address}", flush=True)
            if identity is not None:
                shown = show_fingerprint(identity.fingerprint)
                print(f"station: certificate {shown}; tokens: station access --help", flush=True)

        async def tell_of_robot() -> None:
            await asyncio.sleep(ROBOT_WITHIN_S)
            for robot in station.robots.values():
                if not robot.state.connected:
                    text = f"station: no {robot.name} yet: {robot.state.reason}. It goes on looking."
                    print(text, file=sys.stderr, flush=True)

        async def run() -> None:
            telling = asyncio.create_task(tell_of_robot())
            try:
                await serve_until_signal(station, make_api(station), listener, started)
            finally:
                telling.cancel()

        request_short_slices()
        with asyncio.Runner(loop_factory=_loop_factory()) as runner:
            runner.run(run())


def _settings(
    settings: StationConfig,
    robot: list[str] | None,
    host: str | None,
    port: int | None,
    data: Path | None,
    backend: str | None,
    insecure: bool,
    executor: str | None = None,
) -> StationConfig:
    """The file's settings with the options over them."""
    slam = overridden(settings.slam, backend=backend or None)
    check_backend(slam.backend)
    return overridden(
        settings,
        api=overridden(settings.api, host=host or None, port=port),
        executor=executor,
        robots=tuple(parse_robot(text, "--robot") for text in robot) if robot else None,
        slam=slam,
        data_dir=data_folder(data, settings),
        access=overridden(settings.access, insecure=insecure or None),
    )


def _loop_factory() -> Callable[[], asyncio.AbstractEventLoop] | None:
    """uvloop where it is installed."""
    try:
        import uvloop
    except ImportError:
        return None
    factory: Callable[[], asyncio.AbstractEventLoop] = uvloop.new_event_loop
    return factory
