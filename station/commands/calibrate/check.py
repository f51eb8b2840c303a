"""`station calibrate check`: does a calibration still hold, by an ordinary recording without a target?"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import msgspec
import typer

from shared.calibration_yaml import calibration_text
from shared.disk import replacing
from station.calibration.assumed import assumed_noise
from station.calibration.targetless.check import CalibrationCheck, check_calibration
from station.calibration.targetless.recording import lively
from station.calibration.targetless.verdict import WAVE
from station.calibration.told import told_whole
from station.commands.options import Json, check_out_file
from station.commands.progress import working
from station.datasets import open_dataset

REFUSED = 2  # exit code


def register(app: typer.Typer) -> None:
    app.command("check")(check)


def check(
    dataset: Annotated[Path, typer.Argument(help="Half a minute of lively motion with images and IMU; no target.")],
    out: Annotated[
        Path, typer.Option("--out", help="The repaired calibration.yaml to write; nothing is written when refused.")
    ],
    calibration: Annotated[
        Path | None,
        typer.Option(
            "--calibration",
            help="What to check: calibration.yaml, camera.yaml or camchain of kalibr's; else the dataset's own.",
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """Check, and repair, how camera and IMU sit on each other by an ordinary recording, without a target.

    Says what this motion shows and what it does not. Exit code 2 when it does not suffice; says what to do.
    """
    check_out_file(out)
    with working(f"opening {dataset.name}") as bar:
        data = open_dataset(dataset, needs_camera=calibration is None)
        known = data.calibration if calibration is None else told_whole(data.calibration, calibration)
        recording = lively(data, known, calibration or dataset)
        found = check_calibration(recording, bar)
    if is_written(found):
        with replacing(out) as file:
            file.write(calibration_text(msgspec.structs.replace(known, camera=found.repaired)).encode())
    assumed = assumed_noise(recording.noise)
    results = found.results()
    results["notes"] += assumed
    print(json.dumps(results) if as_json else summary(found, assumed, out))
    if not found.is_accepted:
        raise typer.Exit(REFUSED)


def summary(found: CalibrationCheck, assumed: list[str], out: Path) -> str:
    """What a person wants to know."""
    lines = [*found.notes, *assumed]
    lines += [f"refused: {reason}" for reason in found.reasons]
    if found.repairs and found.is_accepted:
        lines.append(f"the calibration does not fit: {' and '.join(found.repairs)} repaired")
    elif found.fits:
        lines.append("the calibration fits")
    elif found.is_accepted:
        unseen = " and ".join(found.unseen)
        lines.append(f"what this motion shows fits; it does not show {unseen}: {WAVE}")
    lines.append(f"written to {out}" if is_written(found) else f"{out} is not written")
    return "\n".join(lines)


def is_written(found: CalibrationCheck) -> bool:
    """Whether the recording vouches for a calibration: for the one that was told, or for a repaired one."""
    return found.is_accepted and (bool(found.repairs) or found.fits is True)
