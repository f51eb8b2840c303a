"""`station calibrate camera-imu`: how camera and IMU sit on each other, from a recording waved before a target."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np
import typer

from shared.calibration_yaml import calibration_text
from shared.disk import replacing
from shared.errors import DataError
from station.calibration import CALIBRATE_CAMERA
from station.calibration.camera_files import camchain_yaml
from station.calibration.camera_imu.batch import Solution
from station.calibration.camera_imu.calibrate import calibrate_camera_imu
from station.calibration.camera_imu.recording import open_thinned, read_recording
from station.calibration.camera_imu.unknowns import INTRINSICS
from station.calibration.target_file import read_target
from station.calibration.told import told
from station.commands.options import Json, check_out_file
from station.commands.progress import working

REFUSED = 2  # exit code


def register(app: typer.Typer) -> None:
    app.command("camera-imu")(camera_imu)


def camera_imu(
    dataset: Annotated[Path, typer.Argument(help="30 to 60 s of images and IMU, waved before the target.")],
    target: Annotated[Path, typer.Option("--target", help="The target.yaml of the board.")],
    out: Annotated[Path, typer.Option("--out", help="The calibration.yaml to write; nothing is written when refused.")],
    camera: Annotated[
        Path | None,
        typer.Option("--camera", help="camera.yaml, calibration.yaml or camchain of kalibr's; else the dataset's."),
    ] = None,
    imu: Annotated[
        Path | None,
        typer.Option("--imu", help="imu.yaml (kalibr's too) or calibration.yaml; else the dataset's."),
    ] = None,
    kalibr: Annotated[
        Path | None, typer.Option("--kalibr", help="Write kalibr's camchain, with T_cam_imu, here as well.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Find how camera and IMU sit on each other: rotation, position, time shift, line delay, gravity.

    Exit code 2 when the recording does not suffice; says what to do.
    """
    for path in (out, kalibr):
        if path is not None:
            check_out_file(path)
    board = read_target(target)
    with working(f"opening {dataset.name}") as bar:
        data = open_thinned(dataset)
        known = told(data.calibration, camera, imu)
        lens = known.camera
        if lens is None or not data.has_images:
            raise DataError(f"{dataset} holds no images with a camera.yaml; record the camera as well")
        if not lens.is_measured:
            where = camera or dataset
            raise DataError(f"{where}: the lens is a guess; {CALIBRATE_CAMERA} and give --camera")
        found = calibrate_camera_imu(read_recording(data, board, lens, known, bar), bar.step)
    if found.is_accepted and found.solution is not None:
        measured = found.solution.unknowns.camera
        with replacing(out) as file:
            file.write(calibration_text(msgspec.structs.replace(known, camera=measured)).encode())
        if kalibr is not None:
            with replacing(kalibr) as file:
                file.write(camchain_yaml(measured).encode())
    results = found.results()
    if found.solution is not None:
        results["sigma"] |= lens_sigma(found.solution)
    print(json.dumps(results) if as_json else summary(results, out))
    if not found.is_accepted:
        raise typer.Exit(REFUSED)


def lens_sigma(solution: Solution) -> dict[str, Any]:
    """How well the lens is known, as it was refined."""
    sigma = solution.sigma(INTRINSICS).tolist()
    return {"intrinsics": sigma[:4], "distortion": sigma[4:]}


def summary(results: dict[str, Any], out: Path) -> str:
    """What a person wants to know."""
    lines = []
    if results["sigma"] is not None:
        T, sigma = np.array(results["T_body_cam"]), results["sigma"]
        position = ", ".join(
            f"{1e3 * t:.1f} ± {1e3 * s:.1f}" for t, s in zip(T[:3, 3], sigma["translation_m"], strict=True)
        )
        lines = [
            f"rotation     {np.array2string(T[:3, :3], precision=4, suppress_small=True, prefix=' ' * 13)}",
            f"             ± {max(sigma['rotation_deg']):.3f}°",
            f"position     {position} mm of the camera from the IMU",
            f"time shift   {1e3 * results['time_shift_s']:.3f} ± {1e3 * sigma['time_shift_s']:.3f} ms",
            f"line delay   {1e6 * results['line_delay_s']:.2f} ± {1e6 * sigma['line_delay_s']:.2f} µs",
            f"focal length {results['intrinsics'][0]:.2f} ± {sigma['intrinsics'][0]:.2f} px, as it was refined",
            f"left over    {results['rms_px']:.2f} px, {math.degrees(results['rms_gyro']):.2f} °/s,"
            f" {results['rms_accel']:.3f} m/s²",
        ]
    lines += results["notes"]
    lines += [f"refused: {reason}" for reason in results["reasons"]]
    return "\n".join(lines if results["reasons"] else [*lines, f"written to {out}"])
