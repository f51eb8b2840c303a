"""`station calibrate imu`: noise and errors of the inertial unit from a recording at rest."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from shared.errors import DataError
from station.commands.options import Json, check_out_file
from station.commands.progress import working

if TYPE_CHECKING:
    from shared.calibration import Calibration
    from station.model.frames import ImuBatch

REFUSED = 2


def register(app: typer.Typer) -> None:
    app.command("imu")(calibrate)


def calibrate(
    dataset: Annotated[
        Path, typer.Argument(help="A recording of the robot lying still, half an hour of it; then on each side.")
    ],
    out: Annotated[Path, typer.Option("--out", help="The imu.yaml to write; a plot, .png, is written beside it.")],
    motors: Annotated[
        Path | None, typer.Option(help="A recording of the robot on blocks, its motors running, half a minute of it.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Measure an IMU's noise at rest, and on all sides its accelerometer's scale, misalignment and bias.

    Exit code 2: the recording is refused, with reasons.
    """
    from shared.calibration_yaml import imu_text
    from shared.disk import replacing
    from station.calibration.imu.calibrate import calibrate_imu
    from station.calibration.imu.plot import draw_allan
    from station.calibration.imu.report import calibration_json, calibration_lines

    if out.suffix.lower() not in (".yaml", ".yml"):
        raise DataError(f"--out {out} must end in .yaml")
    plot = out.with_suffix(".png")
    check_out_file(out)
    check_out_file(plot)
    with working("reading") as bar:
        samples, believed = _read(dataset)
        shaken = None if motors is None else _read(motors)[0]
        bar.step("fitting")
        found = calibrate_imu(samples, believed.imu, shaken, believed.gravity)
        if found.gyro is not None and found.accel is not None:
            draw_allan(found.gyro, found.accel, plot)
    for line in calibration_lines(found):
        print(line, file=sys.stderr if as_json else sys.stdout)
    if found.accepted and found.used is not None:
        with replacing(out) as file:
            file.write(imu_text(found.used).encode())
        print(f"written to {out} and {plot}", file=sys.stderr if as_json else sys.stdout)
    if as_json:
        print(json.dumps(calibration_json(found)))
    if not found.accepted:
        raise typer.Exit(REFUSED)


def _read(path: Path) -> tuple[ImuBatch, Calibration]:
    from station.datasets import open_dataset

    data = open_dataset(path, needs_camera=False, needs_upright=False)
    if data.imu is None:
        raise DataError(f"{path} holds no IMU samples; give a recording of a robot with an IMU")
    return data.imu, data.calibration
