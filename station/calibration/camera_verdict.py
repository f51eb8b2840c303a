"""Whether a calibrated camera can be used; if not, why, and what to do about it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from shared.geometry import FloatArray
from station.calibration.camera import GRID, CameraFit, best_lens, covered_cells
from station.calibration.distortion import ROBOT_LENSES

MAX_FOCAL_ERROR = 0.03  # of the focal length, from which on it spoils a map
MAX_FOCAL_SIGMA = MAX_FOCAL_ERROR / 3.0
MAX_CENTRE_SIGMA = 0.015  # of the image's width
LEAST_COVERAGE = 0.35
LEAST_TILT_DEG = 12.0  # of the most tilted fifth of the views
LEAST_SPREAD_DEG = 4.0  # of the directions that the board faces, in the lesser of two
LEAST_SPAN = 0.08  # of the image's diagonal: the board in the median view
MAX_BEND = 0.01  # of its length
MAX_GAP_ERROR = 0.03
MAX_RMS = 1.5e-3  # of the image's width: 1 px of 640
HIGHER_NAMES = ("k3", "k4", "k5", "k6")  # of radtan5 and radtan8; the others may well be zero
MAX_LEFT_OUT = 0.2  # of the corners


def reasons_against(found: CameraFit) -> list[str]:
    """Sentences with a remedy each; empty where the calibration can be used."""
    poses = list(_poses(found))
    # A board that is not as its file says spoils everything else; but only tilts to all sides tell a bend from a lens.
    # What it does not explain speaks first: no bend and no gap is read off corners that lie elsewhere even so.
    is_explained = found.shape.rms_px <= _most_left_px(found)
    wrong_board = [*_gap(found), *([] if poses else _bend(found))] if is_explained else []
    return wrong_board or [*_misfit(found), *poses, *_places(found), *_vague(found)]


def _most_left_px(found: CameraFit) -> float:
    return MAX_RMS * max(found.size[0], 640)


def _bend(found: CameraFit) -> Iterator[str]:
    length_mm = 1e3 * float(np.linalg.norm(np.ptp(found.target.corners, axis=0)))
    moves_focal = np.abs(found.shape.moves[:2] / found.fit.numbers[:2]).max()
    if found.shape.bend > MAX_BEND or moves_focal > MAX_FOCAL_ERROR:
        yield (
            f"the board is bent, by {found.shape.bend * length_mm:.1f} mm over {length_mm:.0f} mm; "
            "glue it to something flat and take the images again"
        )


def _gap(found: CameraFit) -> Iterator[str]:
    if abs(found.shape.gap_ratio - 1.0) > MAX_GAP_ERROR:
        spacing = found.target.gap_m / found.target.square_m
        yield (
            f"the target is another one: its gaps are {found.shape.gap_ratio * spacing:.2f} of a tag, "
            f"target.yaml says {spacing:.2f}; measure the board and correct tagSize and tagSpacing"
        )


def _poses(found: CameraFit) -> Iterator[str]:
    """How the board was held."""
    normals = found.fit.R_cam_board[:, :, 2]
    tilt = np.degrees(np.arccos(np.clip(np.abs(normals[:, 2]), 0.0, 1.0)))
    spread = np.degrees(np.sqrt(np.maximum(np.linalg.eigvalsh(np.cov(normals.T))[1], 0.0)))
    if float(np.percentile(tilt, 80)) < LEAST_TILT_DEG:
        yield "the board always faced the camera; tilt it by 30 to 45 degrees, to every side"
    elif spread < LEAST_SPREAD_DEG:
        yield "the board was tilted in one direction only; tilt it up, down, left and right"
    spans = [float(np.linalg.norm(np.ptp(view.corners_px, axis=0))) for view in found.views]
    if float(np.median(spans)) < LEAST_SPAN * float(np.hypot(*found.size)):
        yield "the board was too far away; bring it nearer, until it fills half of the image"


def _places(found: CameraFit) -> Iterator[str]:
    cells = covered_cells(found.corners.uv_px, found.size)
    if cells.mean() < LEAST_COVERAGE:
        yield (
            f"the board was seen in {100 * cells.mean():.0f} % of the image only; "
            f"hold it also {_where_not(cells)}, partly beyond the edge where the target has tags"
        )


def _where_not(cells: FloatArray) -> str:
    """The thirds of the image in which least was seen, in words."""
    columns, rows = GRID
    names = []
    for across, column in (("left", slice(0, columns // 3)), ("right", slice(-(columns // 3), None))):
        for down, row in (("upper", slice(0, rows // 3)), ("lower", slice(-(rows // 3), None))):
            if cells[row, column].mean() < 0.5:
                names.append(f"{down} {across}")
    return f"in the {', '.join(names)} of the image" if names else "all over the image"


def _misfit(found: CameraFit) -> Iterator[str]:
    """What is left over is more than any lens leaves."""
    fit = found.fit
    if found.rms_px > _most_left_px(found) or 1.0 - fit.is_inlier.mean() > MAX_LEFT_OUT:
        best = best_lens(found.trials)
        remedy = (
            f"take --model {best.lens}, which foretells other images to {best.validation_px:.2f} px"
            if best.lens != fit.lens and best.left_out < MAX_LEFT_OUT
            else "see that the board is flat, is the one that target.yaml describes, and is held still"
        )
        yield (
            f"the lens model {fit.lens} does not fit: {found.rms_px:.2f} px are left, and "
            f"{100 * (1 - fit.is_inlier.mean()):.0f} % of the corners are farther off; {remedy}"
        )


def _vague(found: CameraFit) -> Iterator[str]:
    """What the images leave open."""
    fit, (width, _) = found.fit, found.size
    focal_sigma = float(np.max(found.scatter[:2] / fit.numbers[:2]))
    centre_sigma = float(np.max(found.scatter[2:4]))
    unsure = [
        name
        for name, value, sigma in zip(found.names, fit.numbers, found.scatter, strict=True)
        if name in HIGHER_NAMES and fit.lens not in ROBOT_LENSES and not sigma < abs(value)
    ]
    if unsure:
        yield f"the images do not tell {', '.join(unsure)} of the lens model {fit.lens}; take --model radtan"
    if not focal_sigma < MAX_FOCAL_SIGMA:
        yield (
            f"the focal length is known to {min(100 * focal_sigma, 999.0):.1f} % only; "
            "take more images, with the board tilted by 30 to 45 degrees, near and far"
        )
    elif not centre_sigma < MAX_CENTRE_SIGMA * width:
        yield (
            f"the centre of the image is known to {min(centre_sigma, 9999.0):.0f} px only; "
            "take more images, with the board tilted to every side and turned by a quarter"
        )
