"""A camera's lens from views of a target: the fit, what it leaves out, how sure it is, and whether it can be used."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import cv2
import numpy as np

from shared.geometry import FloatArray
from station.calibration.boards import homography
from station.calibration.bundle import (
    Corners,
    Fit,
    covariance,
    fit_camera,
    fit_poses,
    fit_wider,
    refit,
    residuals,
    stack_views,
)
from station.calibration.distortion import LENS_NAMES, NARROWER, ROBOT_LENSES, LensName
from station.calibration.layout import is_other_board
from station.calibration.target import BoardView, Target

LEAST_VIEWS = 6
MAX_VIEWS = 150  # of a long recording, those that differ most
SAME_PLACE = 0.01  # of the image's diagonal: a board nearer to one seen before tells nothing new
WORSE = 3.0  # times the other images' error, from which on an image disagrees with them
LEAST_DISAGREEMENT_PX = 0.5
FOLDS = 4
GRID = (8, 6)  # of the image, for the coverage
NUMBER_NAMES = ("fx", "fy", "cx", "cy")
DISTORTION_NAMES = {
    "radtan": ("k1", "k2", "p1", "p2"),
    "radtan5": ("k1", "k2", "p1", "p2", "k3"),
    "radtan8": ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
    "equidistant": ("k1", "k2", "k3", "k4"),
}


Cause = Literal["unreadable", "size", "no board", "other board", "blurred", "repeated", "disagrees"]


@dataclass(frozen=True, slots=True)
class Rejected:
    """An image that is not used, and why."""

    image: str
    cause: Cause
    reason: str


@dataclass(frozen=True, slots=True)
class LensTrial:
    """How well one lens model fits."""

    lens: LensName
    rms_px: float  # of the corners it was fitted to
    validation_px: float  # of all corners of images it was not fitted to, each error counted as 2 px at most
    left_out: float  # share of the corners that it does not reach


@dataclass(frozen=True, slots=True, eq=False)
class Shape:
    """How the board differs from what its file says."""

    bend: float  # how far it is from flat, over its length
    gap_ratio: float  # the gap between an AprilGrid's tags over what its file says
    moves: FloatArray  # (k,) by how much the camera's numbers change when the board may have this shape
    rms_px: float  # left over of the corners when it may: a shape that does not explain them is not the board's


@dataclass(frozen=True, slots=True, eq=False)
class CameraFit:
    """A calibrated camera with all that is needed to judge it."""

    target: Target
    size: tuple[int, int]
    views: tuple[BoardView, ...]  # those it was fitted to
    corners: Corners
    fit: Fit
    scatter: FloatArray  # of fit.numbers, one standard deviation: what the images alone say
    trials: tuple[LensTrial, ...]
    shape: Shape

    @property
    def sigma(self) -> FloatArray:
        """One standard deviation of fit.numbers.

        A board that is bent by less than is refused bends every image alike: no image that is left out shows it.
        """
        return np.hypot(self.scatter, self.shape.moves)

    @property
    def rms_px(self) -> float:
        """Root mean square of the lengths of the residuals."""
        return _rms(residuals(self.corners, self.fit)[self.fit.is_inlier])

    @property
    def coverage(self) -> float:
        """Share of the image, in GRID cells, in which a corner was seen."""
        return float(covered_cells(self.corners.uv_px, self.size).mean())

    @property
    def names(self) -> tuple[str, ...]:
        """Of fit.numbers."""
        return NUMBER_NAMES + DISTORTION_NAMES[self.fit.lens]


def covered_cells(uv_px: FloatArray, size: tuple[int, int]) -> FloatArray:
    """(rows, columns) 1 where a corner was seen in this cell of the image, else 0."""
    cells = np.zeros((GRID[1], GRID[0]))
    column, row = np.clip(uv_px / np.array(size) * GRID, 0, np.array(GRID) - 1).astype(int).T
    cells[row, column] = 1.0
    return cells


def calibrate_camera(
    target: Target,
    views: Sequence[BoardView],
    size: tuple[int, int],
    lens: LensName | None = None,
    advance: Callable[[str], None] = lambda _: None,
    choose: Callable[[Sequence[LensTrial]], LensName] | None = None,
) -> tuple[CameraFit | None, tuple[Rejected, ...]]:
    """The camera that took these views, None where too few are left; and the views that were rejected.

    Args:
        size: width and height of the images, px.
        lens: None: as `choose` says.
        choose: None: most_read_lens.
    """
    if is_other_board(target, views):
        return None, tuple(Rejected(view.name, "other board", "shows another board than target.yaml") for view in views)
    different, rejected = different_views(target, views, size)
    views = different
    if len(views) < LEAST_VIEWS:
        return None, rejected
    advance("fitting the camera")
    fit, corners, views, disagreeing = _agreeing(target, views, lens or "radtan", size)
    if len(views) < LEAST_VIEWS:
        return None, rejected + disagreeing
    trials, fits = [], {fit.lens: fit}
    for trial in LENS_NAMES:
        advance(f"trying the lens model {trial}")
        if trial not in fits:
            narrower = fits.get(NARROWER.get(trial, trial))
            fits[trial] = fit_wider(corners, narrower, trial) if narrower else fit_camera(corners, trial, size)
        trials.append(try_lens(target, views, corners, fits[trial]))
    if lens is None and (chosen := (choose or most_read_lens)(trials)) != "radtan":
        fit, corners, views, disagreeing = _agreeing(target, different, chosen, size)  # another lens, others disagree
    advance("judging")
    shape = board_shape(target, views, fit)
    scatter = np.sqrt(np.diag(covariance(corners, fit)))
    return CameraFit(target, size, views, corners, fit, scatter, tuple(trials), shape), rejected + disagreeing


def most_read_lens(trials: Sequence[LensTrial]) -> LensName:
    """Radial-tangential, which every program reads, unless it leaves twice as much as equidistant does."""
    radtan, equidistant = (next(t for t in trials if t.lens == name) for name in ROBOT_LENSES)
    return "equidistant" if radtan.rms_px > 2.0 * equidistant.rms_px else "radtan"


def foretelling_lens(trials: Sequence[LensTrial]) -> LensName:
    """For the robot, which reads both: radial-tangential, unless equidistant foretells unseen images clearly better.

    What a model leaves where the board was says little of the image's border, where a robot's landmarks lie too.
    """
    best, radtan = best_lens(trials), next(t for t in trials if t.lens == "radtan")
    return best.lens if is_clearly_better(best, radtan) else "radtan"


def is_clearly_better(one: LensTrial, other: LensTrial) -> bool:
    """Whether it foretells images that it has not seen a tenth better."""
    return one.validation_px < 0.9 * other.validation_px


def best_lens(trials: Sequence[LensTrial]) -> LensTrial:
    """The one that foretells images it has not seen best, among those that the robot reads."""
    return min((t for t in trials if t.lens in ROBOT_LENSES), key=lambda t: t.validation_px)


def try_lens(target: Target, views: Sequence[BoardView], corners: Corners, whole: Fit) -> LensTrial:
    """Fit the lens model of `whole`, a fit to these views, to all but a quarter in turn, foretelling that quarter."""
    errors = []
    folds = min(FOLDS, len(views))
    for fold in range(folds):
        kept = [i for i in range(len(views)) if i % folds != fold]
        left = [views[i] for i in range(len(views)) if i % folds == fold]
        start = replace(
            whole,
            R_cam_board=whole.R_cam_board[kept],
            t_cam_board=whole.t_cam_board[kept],
            is_inlier=np.concatenate([whole.is_inlier[corners.view == i] for i in kept]),
        )
        fitted = refit(stack_views(target, [views[i] for i in kept]), start)
        unseen = stack_views(target, left)
        errors.append(np.linalg.norm(residuals(unseen, fit_poses(unseen, fitted)), axis=1))
    capped = np.minimum(np.concatenate(errors), 2.0)
    return LensTrial(
        whole.lens,
        _rms(residuals(corners, whole)[whole.is_inlier]),
        float(np.sqrt(np.mean(capped**2))),
        float(1.0 - whole.is_inlier.mean()),
    )


def different_views(
    target: Target, views: Sequence[BoardView], size: tuple[int, int]
) -> tuple[tuple[BoardView, ...], tuple[Rejected, ...]]:
    """The views without those that show the board where another one does, MAX_VIEWS at most."""
    apart_px = SAME_PLACE * float(np.hypot(*size))
    places = [_board_outline(target, view) for view in views]
    while True:
        kept: list[int] = []
        same: dict[int, int] = {}
        for i, place in enumerate(places):
            nearest = min(kept, key=lambda k: float(np.abs(places[k] - place).max()), default=None)
            if nearest is None or float(np.abs(places[nearest] - place).max()) > apart_px:
                kept.append(i)
            else:
                same[i] = nearest
        if len(kept) <= MAX_VIEWS:
            break
        apart_px *= 1.3
    rejected = tuple(
        Rejected(views[i].name, "repeated", f"adds nothing: the board is where it is in {views[k].name}")
        for i, k in same.items()
    )
    return tuple(views[i] for i in kept), rejected


def board_shape(target: Target, views: Sequence[BoardView], fit: Fit) -> Shape:
    """Free the board's own shape: bent to a paraboloid, and the gaps of its tags of another length."""
    p = target.corners
    length = float(np.linalg.norm(np.ptp(p, axis=0)))
    x, y = ((p - p.mean(axis=0)) / length)[:, :2].T
    flat = np.zeros_like(x)
    bends = [np.stack([flat, flat, length * power], axis=1) for power in (x * x, x * y, y * y)]
    tag = np.arange(len(p)) // 4
    gaps = np.stack([tag % target.columns * target.gap_m, tag // target.columns * target.gap_m, flat], axis=1)
    shapes = np.stack([*bends, gaps] if target.kind == "aprilgrid" else bends, axis=2)
    corners = stack_views(target, views, shapes)
    start = replace(fit, numbers=np.append(fit.numbers, np.zeros(shapes.shape[2])))
    refitted = refit(corners, start)
    freed = refitted.numbers
    moves, numbers = freed[: len(fit.numbers)] - fit.numbers, freed[len(fit.numbers) :]
    height = np.stack([x * x, x * y, y * y], axis=1) @ numbers[:3]
    plane = np.stack([x, y, np.ones_like(x)], axis=1)
    bent = height - plane @ np.linalg.lstsq(plane, height, rcond=None)[0]
    gap_ratio = 1.0 + float(numbers[3]) if target.kind == "aprilgrid" else 1.0
    left_px = _rms(residuals(corners, refitted)[refitted.is_inlier])
    return Shape(float(np.ptp(bent)), gap_ratio, moves, left_px)


def _agreeing(
    target: Target, views: tuple[BoardView, ...], lens: LensName, size: tuple[int, int]
) -> tuple[Fit, Corners, tuple[BoardView, ...], tuple[Rejected, ...]]:
    """Fit, leave out the images that disagree with the others, and fit again."""
    rejected: tuple[Rejected, ...] = ()
    while True:
        corners = stack_views(target, views)
        fit = fit_camera(corners, lens, size)
        length = np.linalg.norm(residuals(corners, fit), axis=1)
        errors = np.array([np.median(length[corners.view == i]) for i in range(len(views))])
        limit = max(WORSE * float(np.median(errors)), LEAST_DISAGREEMENT_PX)
        bad = errors > limit
        if not bad.any() or (~bad).sum() < LEAST_VIEWS:
            return fit, corners, views, rejected
        rejected += tuple(
            Rejected(
                view.name,
                "disagrees",
                f"disagrees with the other images by {error:.1f} px: the board or the camera moved",
            )
            for view, error in zip(views, errors, strict=True)
            if error > limit
        )
        views = tuple(view for view, is_bad in zip(views, bad, strict=True) if not is_bad)


def _board_outline(target: Target, view: BoardView) -> FloatArray:
    """Where the whole board's four outer corners are in the image (8,), by a homography."""
    low, high = target.corners[:, :2].min(axis=0), target.corners[:, :2].max(axis=0)
    outer = np.array([low, [high[0], low[1]], high, [low[0], high[1]]])
    H = homography(target.corners[view.ids, :2], view.corners_px)
    if H is None:
        return np.tile(view.corners_px.mean(axis=0), 4)
    return np.asarray(cv2.perspectiveTransform(outer[None], H)[0]).ravel()


def _rms(residual: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.sum(residual**2, axis=1))))
