"""The motion that best maps one set of points onto another, point by point."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from shared.errors import DegenerateGeometry
from shared.geometry import FloatArray, sim3, transform, yaw_rotation

AlignmentKind = Literal["yaw", "se3", "sim3"]
MIN_SPREAD = 1e-12  # m^2: below it all points are one point
LMEDS_SAMPLES = 500  # of three points each: one of them is free of outliers, though half of the points may be some
LMEDS_CUT = 2.5  # standard deviations, of what is kept for the last fit (Rousseeuw and Leroy 1987, section 5.1)


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """Source mapped onto target."""

    T_target_source: FloatArray  # (4, 4), upper-left 3x3 is scale * R
    R_target_source: FloatArray  # (3, 3)
    scale: float
    rms: float  # of the distances that remain, target units


def align_points(p_target: FloatArray, p_source: FloatArray, kind: AlignmentKind = "se3") -> Alignment:
    """Find the motion that best maps source points onto their target points, in the least-squares sense.

    Args:
        p_target: (N, 3), target frame; row i corresponds to row i of p_source.
        p_source: (N, 3), source frame.
        kind: "yaw" (rotation about z and translation: what is unknown where gravity and scale are known), "se3"
            (any rotation, translation), "sim3" (also scale).
    Raises:
        DegenerateGeometry: too few points, or all on one line ("se3", "sim3") or one vertical ("yaw"), so that a
            rotation stays unknown.
    Source: Umeyama, IEEE TPAMI 13(4), 1991, eqs. 34-43; "yaw" is the same problem in the plane.
    """
    if p_target.shape != p_source.shape or p_target.ndim != 2 or p_target.shape[1] != 3:
        raise DegenerateGeometry(f"points of shape {p_target.shape} and {p_source.shape} cannot be matched row by row")
    if len(p_source) < 2:
        raise DegenerateGeometry(f"{len(p_source)} points are too few to align")
    mu_target, mu_source = p_target.mean(axis=0), p_source.mean(axis=0)  # eqs. 34, 35
    target, source = p_target - mu_target, p_source - mu_source
    scale = 1.0
    if kind == "yaw":
        R = _best_yaw(target, source)
    else:
        cov = target.T @ source / len(source)  # eq. 38
        U, D, Vt = np.linalg.svd(cov)
        if D[0] <= MIN_SPREAD or D[1] <= 1e-9 * D[0]:
            raise DegenerateGeometry("points lie on one line, so that a rotation stays unknown")
        S = np.array([1.0, 1.0, np.sign(np.linalg.det(U) * np.linalg.det(Vt))])  # eq. 43: no mirror image
        R = (U * S) @ Vt  # eq. 40
        if kind == "sim3":
            scale = float((D * S).sum() / (source**2).sum(axis=1).mean())  # eq. 42
    T = sim3(scale, R, mu_target - scale * R @ mu_source)  # eq. 41
    rms = float(np.sqrt(((p_target - transform(T, p_source)) ** 2).sum(axis=1).mean()))
    return Alignment(T, R, scale, rms)


def align_most_points(p_target: FloatArray, p_source: FloatArray) -> Alignment:
    """The similarity that maps most of the points well, though nearly half of them may be anywhere.

    Same input, same result. Arguments and errors are those of `align_points`.
    Source: least median of squares (Rousseeuw, J. Am. Stat. Assoc. 79, 1984), then least squares on what agrees.
    """
    count = len(p_source)
    if count < 4:
        raise DegenerateGeometry(f"{count} points are too few to tell which of them are wrong")
    rng = np.random.default_rng(0)
    best, least = None, np.inf
    for _ in range(LMEDS_SAMPLES):
        rows = rng.choice(count, 3, replace=False)
        try:
            found = align_points(p_target[rows], p_source[rows], "sim3")
        except DegenerateGeometry:
            continue
        median = float(np.median(_squares(found, p_target, p_source)))
        if median < least:
            best, least = found, median
    if best is None:
        raise DegenerateGeometry("points lie on one line, so that a rotation stays unknown")
    sigma = 1.4826 * (1 + 5 / (count - 3)) * np.sqrt(least)
    agree = _squares(best, p_target, p_source) <= max((LMEDS_CUT * sigma) ** 2, MIN_SPREAD)
    return align_points(p_target[agree], p_source[agree], "sim3")


def _squares(alignment: Alignment, p_target: FloatArray, p_source: FloatArray) -> FloatArray:
    """(N,) squared distances that remain."""
    return np.square(p_target - transform(alignment.T_target_source, p_source)).sum(axis=1)


def align_poses(T_target: FloatArray, T_source: FloatArray, lever: float) -> Alignment:
    """The similarity that best maps source poses onto their target poses (N, 4, 4): also of a short or straight path.

    Orientations count for the rotation, as much as positions `lever` (source units) away from the bodies would; scale
    is the positions' alone.
    Raises:
        DegenerateGeometry: too few poses, or the body did not move, so that the scale stays unknown.
    """
    if len(T_target) != len(T_source) or len(T_source) < 2:
        raise DegenerateGeometry(f"{len(T_source)} poses are too few to align")
    mu_target, mu_source = T_target[:, :3, 3].mean(axis=0), T_source[:, :3, 3].mean(axis=0)
    target, source = T_target[:, :3, 3] - mu_target, T_source[:, :3, 3] - mu_source
    spread = float(np.square(source).sum())
    if spread <= MIN_SPREAD * len(source):
        raise DegenerateGeometry("the body did not move, so that the scale stays unknown")
    turns = np.einsum("nij,nkj->ik", T_target[:, :3, :3], T_source[:, :3, :3])
    scale = float(np.sqrt(np.square(target).sum() / spread))
    for _ in range(10):  # the scale weighs orientations; it has settled after three rounds
        U, _, Vt = np.linalg.svd(target.T @ source + scale * lever**2 * turns)
        R = (U * [1.0, 1.0, np.sign(np.linalg.det(U) * np.linalg.det(Vt))]) @ Vt
        scale = float((target * (source @ R.T)).sum() / spread)
        if scale <= 0:
            raise DegenerateGeometry("positions contradict orientations")
    T = sim3(scale, R, mu_target - scale * R @ mu_source)
    rms = float(np.sqrt(np.square(T_target[:, :3, 3] - transform(T, T_source[:, :3, 3])).sum(axis=1).mean()))
    return Alignment(T, R, scale, rms)


def _best_yaw(target: FloatArray, source: FloatArray) -> FloatArray:
    """Rotation about z for centred points: the angle of the complex correlation of their ground-plane parts."""
    cos_part = float((target[:, :2] * source[:, :2]).sum())
    sin_part = float((target[:, 1] * source[:, 0] - target[:, 0] * source[:, 1]).sum())
    if float(np.hypot(cos_part, sin_part)) <= MIN_SPREAD:
        raise DegenerateGeometry("points lie on one vertical line, so that the yaw stays unknown")
    return yaw_rotation(float(np.arctan2(sin_part, cos_part)))
