"""`station calibrate check`: does a calibration still hold, by an ordinary recording without a target?"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np
import typer

from shared.calibration import Calibration, ImuNoise
from shared.calibration_yaml import as_calibration, calibration_text
from shared.disk import replacing
from shared.errors import DataError
from shared.sensor_yaml import CONSUMER_IMU, read_yaml
from station.calibration import CALIBRATE_CAMERA
from station.calibration.targetless.check import CalibrationCheck, LivelyRecording, check_calibration
from station.commands.options import Json, check_out_file
from station.commands.progress import working
from station.datasets import Dataset, open_dataset
from station.model.frames import ImuBatch

REFUSED = 2  # exit code


def register(app: typer.Typer) -> None:
    app.command("check")(check)


def check(
    dataset: Annotated[Path, typer.Argument(help="Half a minute of lively motion with images and IMU; no target.")],
    out: Annotated[
        Path, typer.Option("--out", help="The repaired calibration.yaml to write; nothing is written when refused.")
    ],
    calibration: Annotated[
        Path | None, typer.Option("--calibration", help="The calibration.yaml to check; else the dataset's own.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Check, and repair, how camera and IMU sit on each other by an ordinary recording, without a target.

    Says what this motion shows and what it does not. Exit code 2 when it does not suffice; says what to do.
    """
    check_out_file(out)
    with working(f"opening {dataset.name}") as bar:
        data = open_dataset(dataset, needs_camera=calibration is None)
        known = data.calibration if calibration is None else as_calibration(read_yaml(calibration), calibration)
        found = check_calibration(lively(data, known, calibration or dataset), bar)
    if found.is_accepted:
        with replacing(out) as file:
            file.write(calibration_text(msgspec.structs.replace(known, camera=found.repaired)).encode())
    print(json.dumps(found.results()) if as_json else summary(found, out))
    if not found.is_accepted:
        raise typer.Exit(REFUSED)


def lively(data: Dataset, known: Calibration, where: Path) -> LivelyRecording:
    """A dataset as what is checked. Raises DataError: it has no images, or its lens is not known."""
    if data.read_frames is None:
        raise DataError(f"{data.path} holds no images; record the camera as well")
    if known.camera is None or not known.camera.is_measured:
        raise DataError(f"{where}: the lens is not known; {CALIBRATE_CAMERA} first, and give --calibration")
    empty = ImuBatch(np.zeros(0, dtype=np.int64), np.zeros((0, 3)), np.zeros((0, 3)))
    return LivelyRecording(
        frame_times_ns=data.frame_times_ns,
        read_frames=data.read_frames,
        imu=data.imu or empty,
        camera=known.camera,
        noise=known.imu or data.calibration.imu or ImuNoise(**CONSUMER_IMU, rate_hz=200.0),
        gravity=known.gravity,
        drive=tuple(data.drive),
    )


def summary(found: CalibrationCheck, out: Path) -> str:
    """What a person wants to know."""
    lines = [quantity.sentence for quantity in found.quantities]
    lines += [f"refused: {reason}" for reason in found.reasons]
    if found.is_accepted:
        lines.append("the calibration fits" if found.fits else "the calibration does not fit: repaired")
        lines.append(f"written to {out}")
    return "\n".join(lines)
