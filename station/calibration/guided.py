"""The estimate at the end of a guided calibration: from the recording, of the pictures that counted."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from shared.calibration import CameraCalibration
from shared.disk import replace_file
from shared.errors import DataError
from station.calibration.boards import make_finder, view_board
from station.calibration.camera import LEAST_VIEWS, CameraFit, Rejected, calibrate_camera, foretelling_lens
from station.calibration.camera_page import write_camera_page
from station.calibration.camera_verdict import reasons_against
from station.calibration.layout import OTHER_BOARD
from station.calibration.target import BoardView, Target
from station.datasets import open_dataset
from station.model.frames import ImageFrame

TOO_FEW = "{} different views of the board are too few, at least {} are needed; show more of them"


def estimate_camera(
    recording: Path,
    times_ns: Sequence[int],
    target: Target,
    told: CameraCalibration,
    plot: Path,
    progress: Callable[[float, str], None],
) -> dict[str, Any]:
    """The camera from the recording's pictures of these times (robot clock), in the fields of the contract.

    Where that comes to an estimate, a plot of its residuals is written as PNG.
    Raises DataError: the recording has none of these pictures.
    """
    views = views_of_recording(recording, times_ns, target, lambda share: progress(0.05 + 0.45 * share, "reading"))
    size = (told.width, told.height)
    found, rejected = calibrate_camera(
        target, views, size, advance=lambda text: progress(0.6, text), choose=foretelling_lens
    )
    if found is not None:
        progress(0.9, "drawing the residuals")
        write_camera_page(found, plot)
    return _result(found, told, rejected, len(views) - len(rejected))


def views_of_recording(
    recording: Path, times_ns: Sequence[int], target: Target, progress: Callable[[float], None]
) -> list[BoardView]:
    """What the pictures of these times (robot clock) show of the target. Raises DataError: none of them is there."""
    wanted, finder = set(times_ns), make_finder(target)
    views: list[BoardView] = []
    for event in open_dataset(recording).events():
        if isinstance(event, ImageFrame) and event.t_robot_ns in wanted:
            view = view_board(finder, target, event.grey(), f"{event.t_robot_ns}.jpg", event.t_robot_ns)
            views += [] if view is None else [view]
            progress(len(views) / len(wanted))
    if not views:
        raise DataError("no picture that counts shows the board; show it to the camera until the page says enough")
    return views


def _result(found: CameraFit | None, told: CameraCalibration, rejected: Sequence[Rejected], num: int) -> dict[str, Any]:
    is_other = any(one.cause == "other board" for one in rejected)
    few = OTHER_BOARD if is_other else TOO_FEW.format(num, LEAST_VIEWS)
    reasons = [few] if found is None else reasons_against(found)
    numbers = None if found is None else found.fit.numbers.tolist()
    return {
        "model": None if found is None else "equidistant" if found.fit.lens == "equidistant" else "radtan",
        "resolution": [told.width, told.height],
        "intrinsics": numbers and numbers[:4],
        "distortion": numbers and numbers[4:],
        "rms_px": None if found is None else found.rms_px,
        "sigma": {} if found is None else dict(zip(found.names, found.sigma.tolist(), strict=True)),
        "images_used": 0 if found is None else len(found.views),
        "images_rejected": [{"image": one.image, "reason": one.reason} for one in rejected],
        "coverage": 0.0 if found is None else found.coverage,
        "line_delay_s": None,  # a board that is held still does not tell it
        "accepted": not reasons,
        "reasons": reasons,
    }


def store_result(result: dict[str, Any], path: Path) -> None:
    replace_file(path, json.dumps(result, indent=1).encode())
