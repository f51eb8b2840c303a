"""`station calibrate camera`: a camera's lens from images of a target."""

from __future__ import annotations

import json
from itertools import groupby
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from shared.disk import replacing
from shared.errors import DataError
from station.calibration.camera import (
    LEAST_VIEWS,
    CameraFit,
    LensTrial,
    Rejected,
    best_lens,
    calibrate_camera,
    is_clearly_better,
)
from station.calibration.camera_files import lens_camchain_yaml, lens_yaml, opencv_yaml
from station.calibration.camera_page import write_camera_page
from station.calibration.camera_verdict import reasons_against
from station.calibration.distortion import ROBOT_LENSES, LensName
from station.calibration.target_file import read_target
from station.calibration.views import Views, find_views, other_board, why_few
from station.commands.options import Json, check_out_file
from station.commands.progress import working
from station.datasets import open_dataset

SHOWN = 10  # lines about images that are not used


def register(app: typer.Typer) -> None:
    app.command()(camera)


def camera(
    dataset: Annotated[Path, typer.Argument(help="Images of the target: a folder, ASL folder, video or recording.")],
    target: Annotated[Path, typer.Option("--target", help="The target.yaml of the board.")],
    out: Annotated[Path, typer.Option("--out", help="The camera.yaml to write; nothing is written when refused.")],
    model: Annotated[
        Literal["auto", "radtan", "radtan5", "radtan8", "equidistant"],
        typer.Option(
            help="Lens model; auto: radtan, unless it does not fit and equidistant does. radtan5 and radtan8 are for "
            "OpenCV: written beside --out as .opencv.yaml."
        ),
    ] = "auto",
    kalibr: Annotated[Path | None, typer.Option("--kalibr", help="Write kalibr's camchain here as well.")] = None,
    plots: Annotated[Path | None, typer.Option("--plots", help="Write residuals and coverage here, a .png.")] = None,
    as_json: Json = False,
) -> None:
    """Calibrate a camera's lens. Exit code 2 when the images do not suffice; says what to do."""
    lens: LensName | None = None if model == "auto" else model
    if kalibr is not None and lens is not None and lens not in ROBOT_LENSES:
        raise DataError(f"kalibr has no lens model {lens}; leave out --kalibr, or take --model radtan or equidistant")
    out = _named(out, lens)
    for path in (out, kalibr, plots):
        if path is not None:
            check_out_file(path)
    board = read_target(target)
    data = open_dataset(dataset, needs_camera=False)
    with working(f"opening {dataset.name}") as bar:
        bar.step("looking for the board", len(data.frame_times_ns))
        seen = find_views(board, data, bar.advance)
        found, unused = calibrate_camera(board, seen.views, seen.size, lens, bar.step)
        rejected = (*seen.rejected, *unused)
        if found is None:
            reasons = [why_few(board, seen, seen.looked_at - len(rejected), LEAST_VIEWS, rejected)]
        else:
            reasons = reasons_against(found)
            if reasons and (other := other_board(board, seen)):
                reasons = [other]
            write(found, not reasons, out, kalibr, plots)
    if as_json:
        print(json.dumps(report(found, seen, rejected, reasons)))
    else:
        _print(found, seen, rejected, reasons, [path for path in (out, kalibr, plots) if path is not None])
    if reasons:
        raise typer.Exit(2)


def report(found: CameraFit | None, seen: Views, rejected: tuple[Rejected, ...], reasons: list[str]) -> dict[str, Any]:
    """The JSON object. What is not known, as nothing was fitted, is null."""
    numbers = [] if found is None else found.fit.numbers.tolist()
    return {
        "model": None if found is None else found.fit.lens,
        "resolution": list(seen.size),
        "intrinsics": numbers[:4] or None,
        "distortion": numbers[4:] or None,
        "rms_px": None if found is None else found.rms_px,
        "sigma": {} if found is None else dict(zip(found.names, found.sigma.tolist(), strict=True)),
        "images_used": 0 if found is None else len(found.views),
        "images_rejected": [{"image": item.image, "reason": item.reason} for item in rejected],
        "coverage": 0.0 if found is None else found.coverage,
        "line_delay_s": None,  # boards that are held still do not say it; `station calibrate camera-imu` does
        "accepted": not reasons,
        "reasons": reasons,
    }


def _named(out: Path, lens: LensName | None) -> Path:
    """Where the lens goes: not under the name that was meant for the robot where the robot cannot read it."""
    return out if lens is None or lens in ROBOT_LENSES else out.with_suffix(".opencv.yaml")


def write(found: CameraFit, accepted: bool, out: Path, kalibr: Path | None, plots: Path | None) -> None:
    """The files that were asked for; of a refused camera only what shows why."""
    if plots is not None:
        write_camera_page(found, plots)
    if not accepted:
        return
    numbers = found.fit.numbers.tolist()
    if found.fit.lens not in ROBOT_LENSES:
        with replacing(out) as file:
            file.write(opencv_yaml(found.size, numbers[:4], numbers[4:]).encode())
        return
    lens = (found.size, numbers[:4], found.fit.lens, numbers[4:])
    with replacing(out) as file:
        file.write(lens_yaml(*lens).encode())
    if kalibr is not None:
        with replacing(kalibr) as file:
            file.write(lens_camchain_yaml(*lens).encode())


def _print(
    found: CameraFit | None, seen: Views, rejected: tuple[Rejected, ...], reasons: list[str], files: list[Path]
) -> None:
    """What a person wants to know, in a few lines."""
    if found is not None:
        fit = found.fit
        print(
            f"{len(found.views)} of {seen.looked_at} images used, corners in {100 * found.coverage:.0f} % of the image"
        )
        print(f"{fit.lens}, {found.size[0]}x{found.size[1]}, {found.rms_px:.2f} px left over")
        for name, value, sigma in zip(found.names, fit.numbers, found.sigma, strict=True):
            print(
                f"  {name:<3}{value:11.4f} +- {sigma:.4f}"
                if name[0] in "kp"
                else f"  {name:<3}{value:9.2f} +- {sigma:.2f}"
            )
        best, own = best_lens(found.trials), next(t for t in found.trials if t.lens == fit.lens)
        if is_clearly_better(best, own):
            print(_better(best, own))
    for line in unused(rejected):
        print(line)
    for reason in reasons:
        print(f"refused: {reason}")
    if not reasons:
        print(f"written to {', '.join(map(str, files))}")


def unused(rejected: tuple[Rejected, ...]) -> list[str]:
    """A line for each image that is not used; one for all where many have the same reason."""
    lines = []
    for reason, alike in groupby(sorted(rejected, key=lambda item: item.reason), key=lambda item: item.reason):
        names = [item.image for item in alike]
        which = names[0] if len(names) == 1 else f"{len(names)} images ({names[0]} to {names[-1]})"
        lines.append(f"not used: {which}: {reason}")
    return lines if len(lines) <= SHOWN else [*lines[:SHOWN], f"not used: {len(lines) - SHOWN} more, see --json"]


def _better(best: LensTrial, own: LensTrial) -> str:
    return (
        f"of images not used for it, it foretells corners to {own.validation_px:.2f} px and leaves "
        f"{100 * own.left_out:.1f} % of them out; {best.lens} to {best.validation_px:.2f} px: take --model {best.lens} "
        "for this project's robot, and for a wide lens"
    )
