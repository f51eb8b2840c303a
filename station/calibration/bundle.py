"""Camera, and where the board was in each image, together: least squares that bear wrong corners."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from scipy import special

from shared.geometry import FloatArray, IntArray
from station.calibration.distortion import COUNT, LensName, distort, distortion_slopes, undistorted_guess
from station.calibration.target import BoardView, Target
from station.vision.lens import BoolArray

HUBER = 2.0  # sigmas, from which on a residual pulls no stronger
OUTLIER = 5.0  # sigmas, from which on a corner is left out
LEAST_SIGMA_PX = 0.03  # finer than that no corner is known, however well simulated ones agree
ROUNDS = 6
ROUGH_STEPS = 8  # of a round, at most
STEPS = 40  # of the last one
LEAST_DEPTH_M = 1e-3  # nearer, or behind the camera, a corner is taken to be here
START_VIEWS = 15  # that the focal length to start from is sought in
RAYLEIGH_MEDIAN = 1.1774  # median length of an error of unit sigma in each direction


@dataclass(frozen=True, slots=True, eq=False)
class Corners:
    """Every corner of every view in one table, views one after another."""

    p_board: FloatArray  # (n, 3) m
    uv_px: FloatArray  # (n, 2)
    view: IntArray  # (n,)
    starts: IntArray  # (views,), first row of each view
    shapes: FloatArray  # (n, 3, shapes): how a corner moves with each number of the board's shape, if that is sought

    @property
    def num_views(self) -> int:
        return len(self.starts)


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """A camera, and where the board was."""

    lens: LensName
    numbers: FloatArray  # fx fy cx cy and the distortion; then the numbers of the board's shape, if sought
    R_cam_board: FloatArray  # (views, 3, 3)
    t_cam_board: FloatArray  # (views, 3) m
    is_inlier: BoolArray  # (n,) of the corners
    sigma_px: float  # of a corner in each direction


@dataclass(frozen=True, slots=True, eq=False)
class _Equations:
    """Normal equations, split into the camera's numbers and each view's pose."""

    A: FloatArray  # (views, k, k)
    B: FloatArray  # (views, k, 6)
    C: FloatArray  # (views, 6, 6)
    a: FloatArray  # (views, k)
    c: FloatArray  # (views, 6)


def stack_views(target: Target, views: Sequence[BoardView], shapes: FloatArray | None = None) -> Corners:
    """shapes: (corners of the target, 3, shapes) displacement of each corner by each number of its shape."""
    counts = [len(view.ids) for view in views]
    ids = np.concatenate([view.ids for view in views])
    all_shapes = np.zeros((len(target.corners), 3, 0)) if shapes is None else shapes
    return Corners(
        p_board=target.corners[ids],
        uv_px=np.concatenate([view.corners_px for view in views]),
        view=np.repeat(np.arange(len(views)), counts),
        starts=np.concatenate([[0], np.cumsum(counts)[:-1]]).astype(np.int64),
        shapes=all_shapes[ids],
    )


def fit_camera(corners: Corners, lens: LensName, size: tuple[int, int]) -> Fit:
    """The camera that saw these corners, in images of this width and height (px)."""
    return refit(corners, _best_start(corners, lens, size))


def fit_wider(corners: Corners, fit: Fit, lens: LensName) -> Fit:
    """The same with more numbers of distortion, which lens models have after those of narrower ones."""
    numbers = np.append(fit.numbers, np.zeros(COUNT[lens] - COUNT[fit.lens]))
    return refit(corners, _with_all(replace(fit, lens=lens, numbers=numbers)))


def refit(corners: Corners, start: Fit) -> Fit:
    """The camera that saw these corners, from one that nearly did."""
    fit = start
    for _ in range(ROUNDS):
        before = fit.sigma_px
        fit = _with_noise(corners, _minimise(corners, fit, ROUGH_STEPS))
        if abs(fit.sigma_px - before) < 0.01 * before:
            break
    return _minimise(corners, fit, STEPS)


def fit_poses(corners: Corners, fit: Fit) -> Fit:
    """Where the board was, by a camera that is known; of these views nothing else is used."""
    poses = _with_all(_with_noise(corners, _with_poses(corners, fit.lens, fit.numbers)))
    for _ in range(3):
        poses = _with_noise(corners, _minimise(corners, poses, ROUGH_STEPS, poses_only=True))
    return poses


def residuals(corners: Corners, fit: Fit) -> FloatArray:
    """(n, 2) px, seen minus where the fit expects it."""
    expected, _, _ = _expect(corners, fit)
    return corners.uv_px - expected


def covariance(corners: Corners, fit: Fit) -> FloatArray:
    """(k, k) of the camera's numbers: the larger, number by number, of what the corners' noise and the images say.

    Errors of one image's corners are not independent (blur, a bent board, a lens model that is not quite true), so
    that the noise of single corners claims too much. Leaving out one image after the other (the jackknife over
    clusters) says by how much the numbers really move.
    Source: Cameron and Miller, J. Human Resources 50(2), 2015, sec. VI (CR3).
    """
    linear = _linearise(corners, fit)
    # What was left out because the lens model does not reach it could as well have been taken: it counts here.
    is_inlier = np.linalg.norm(linear[:, :, -1], axis=1) < 3.0 * OUTLIER * fit.sigma_px
    S, s = _reduced(_equations(corners, replace(fit, is_inlier=is_inlier), linear), 0.0)
    H = S.sum(axis=0)
    by_noise = _inverse(H)
    moved = np.stack([_inverse(H - S[i]) @ s[i] for i in range(len(S))])
    views = len(S)
    # Few images know their own scatter badly: Student's distribution, at three sigmas.
    widening = special.stdtrit(max(views - 1, 1), special.ndtr(3.0)) / 3.0
    by_images = widening**2 * (views - 1) / views * (moved - moved.mean(axis=0)).T @ (moved - moved.mean(axis=0))
    larger = np.sqrt(np.maximum(np.diag(by_images) / np.maximum(np.diag(by_noise), 1e-300), 1.0))
    return np.asarray(by_noise * np.outer(larger, larger))


def _inverse(H: FloatArray) -> FloatArray:
    """Of a symmetric matrix whose rows have very different units; large where it is not observable."""
    scale = np.sqrt(np.maximum(np.diag(H), 1e-300))
    values, vectors = np.linalg.eigh(H / np.outer(scale, scale))
    return np.asarray((vectors / np.maximum(values, 1e-12)) @ vectors.T / np.outer(scale, scale))


def _best_start(corners: Corners, lens: LensName, size: tuple[int, int]) -> Fit:
    """Several focal lengths are tried on some of the views; the one with the least residual is taken."""
    width, height = size
    focals = [_focal_of_homographies(corners, size), *(f * max(size) for f in (0.35, 0.6, 1.0, 1.8))]
    some = _some_views(corners)
    tried = []
    for focal in focals:
        numbers = np.zeros(4 + COUNT[lens])
        numbers[:4] = focal, focal, (width - 1) / 2, (height - 1) / 2
        fit = _with_all(_with_noise(some, _with_poses(some, lens, numbers)))
        for _ in range(3):
            fit = _with_all(_with_noise(some, _minimise(some, fit, ROUGH_STEPS)))
        tried.append(fit)
    best = min(tried, key=lambda fit: fit.sigma_px)
    return _with_all(_with_noise(corners, _with_poses(corners, lens, best.numbers)))


def _some_views(corners: Corners) -> Corners:
    """START_VIEWS of the views, evenly over all."""
    chosen = np.unique(np.linspace(0, corners.num_views - 1, START_VIEWS).round().astype(int))
    rows = np.isin(corners.view, chosen)
    view = np.searchsorted(chosen, corners.view[rows])
    starts = np.searchsorted(view, np.arange(len(chosen)))
    return Corners(corners.p_board[rows], corners.uv_px[rows], view, starts, corners.shapes[rows])


def _focal_of_homographies(corners: Corners, size: tuple[int, int]) -> float:
    """Zhang, PAMI 22(11), 2000, with the centre in the middle of the image."""
    pieces = np.split(np.arange(len(corners.view)), corners.starts[1:])
    K = cv2.initCameraMatrix2D(
        [corners.p_board[rows].astype(np.float32) for rows in pieces],
        [corners.uv_px[rows].astype(np.float32) for rows in pieces],
        size,
    )
    focal = float(K[0, 0])
    return focal if 0.2 * max(size) < focal < 20.0 * max(size) else 1.2 * max(size)


def _with_poses(corners: Corners, lens: LensName, numbers: FloatArray) -> Fit:
    """Poses of the board by a camera of these focal lengths, view by view."""
    xy = undistorted_guess(lens, (corners.uv_px - numbers[2:4]) / numbers[:2])
    R, t = np.empty((corners.num_views, 3, 3)), np.empty((corners.num_views, 3))
    if numbers[4 : 4 + COUNT[lens]].any():
        xy = _undistort(lens, (corners.uv_px - numbers[2:4]) / numbers[:2], xy, numbers[4 : 4 + COUNT[lens]])
    for i, rows in enumerate(np.split(np.arange(len(xy)), corners.starts[1:])):
        _, rotation, translation = cv2.solvePnP(
            corners.p_board[rows], xy[rows], np.eye(3), np.zeros(4), flags=cv2.SOLVEPNP_IPPE
        )
        R[i], t[i] = cv2.Rodrigues(rotation)[0], translation.ravel()
    return Fit(lens, numbers, R, t, np.ones(len(xy), dtype=bool), 1.0)


def _undistort(lens: LensName, distorted: FloatArray, guess: FloatArray, d: FloatArray) -> FloatArray:
    xy = guess
    for _ in range(10):
        by_xy = distortion_slopes(lens, xy, d).by_xy
        step = np.linalg.solve(by_xy + 1e-9 * np.eye(2), (distorted - distort(lens, xy, d))[..., None])[..., 0]
        xy = xy + np.clip(step, -0.3, 0.3)
    return xy


def _with_noise(corners: Corners, fit: Fit) -> Fit:
    """The noise, and which corners are outliers, by the residuals of the fit."""
    length = np.linalg.norm(residuals(corners, fit), axis=1)
    sigma = max(LEAST_SIGMA_PX, float(np.median(length)) / RAYLEIGH_MEDIAN)
    return replace(fit, sigma_px=sigma, is_inlier=length < OUTLIER * sigma)


def _with_all(fit: Fit) -> Fit:
    """No corner left out: a view whose pose is still wrong would lose all of its own, and its pose stay wrong."""
    return replace(fit, is_inlier=np.ones_like(fit.is_inlier))


def _minimise(corners: Corners, fit: Fit, steps: int, poses_only: bool = False) -> Fit:
    """Levenberg and Marquardt's steps until nothing moves."""
    damping = 1e-3
    linear = _linearise(corners, fit)
    cost = _cost(linear[:, :, -1], fit)
    for _ in range(steps):
        equations = _equations(corners, fit, linear)
        tried = _step(fit, equations, damping, poses_only)
        tried_linear = _linearise(corners, tried)
        tried_cost = _cost(tried_linear[:, :, -1], tried)
        if not tried_cost < cost:
            damping *= 8.0
            if damping > 1e8:
                break
            continue
        gain = 1.0 - tried_cost / cost
        fit, cost, linear = tried, tried_cost, tried_linear
        damping = max(damping / 8.0, 1e-9)
        if gain < 1e-6:
            break
    return fit


def _cost(residual: FloatArray, fit: Fit) -> float:
    """Huber's, of the inliers."""
    r = np.linalg.norm(residual[fit.is_inlier], axis=1) / fit.sigma_px
    return float(np.where(r < HUBER, 0.5 * r * r, HUBER * (r - 0.5 * HUBER)).sum())


def _step(fit: Fit, equations: _Equations, damping: float, poses_only: bool) -> Fit:
    k = len(fit.numbers)
    change = np.zeros(k)
    if not poses_only:
        S, s = _reduced(equations, damping)
        H = S.sum(axis=0)
        scale = np.sqrt(np.maximum(np.diag(H), 1e-12))
        damped = H / np.outer(scale, scale) + damping * np.eye(k)
        change = -np.linalg.lstsq(damped, s.sum(axis=0) / scale, rcond=None)[0] / scale
        change[:2] = np.clip(change[:2], -0.3 * fit.numbers[:2], 0.5 * fit.numbers[:2])
    C = _damped(equations.C, damping)
    right = equations.c + np.einsum("vkp,k->vp", equations.B, change)
    poses = -np.linalg.solve(C, right[..., None])[..., 0]
    turn = np.stack([cv2.Rodrigues(w)[0] for w in np.clip(poses[:, :3], -0.5, 0.5)])
    return replace(
        fit,
        numbers=fit.numbers + change,
        R_cam_board=turn @ fit.R_cam_board,
        t_cam_board=fit.t_cam_board + poses[:, 3:],
    )


def _damped(C: FloatArray, damping: float) -> FloatArray:
    diagonal = np.einsum("vpp->vp", C)
    return np.asarray(C + (damping * diagonal + 1e-12)[:, :, None] * np.eye(6))


def _reduced(equations: _Equations, damping: float) -> tuple[FloatArray, FloatArray]:
    """Each view's share (views, k, k) and (views, k) of the equations of the camera alone (Schur complement)."""
    solved = np.linalg.solve(_damped(equations.C, damping), np.concatenate(
        [equations.B.transpose(0, 2, 1), equations.c[:, :, None]], axis=2))  # fmt: skip
    S = equations.A - equations.B @ solved[:, :, :-1]
    s = equations.a - (equations.B @ solved[:, :, -1:])[:, :, 0]
    return S, s


def _equations(corners: Corners, fit: Fit, linear: FloatArray) -> _Equations:
    length = np.linalg.norm(linear[:, :, -1], axis=1) / fit.sigma_px
    weight = fit.is_inlier * np.minimum(1.0, HUBER / np.maximum(length, 1e-9)) / fit.sigma_px**2
    rows = linear.reshape(-1, linear.shape[2])
    weighted = (linear * weight[:, None, None]).reshape(rows.shape)
    # All products of the columns with one another, view by view: a product of two tall matrices each.
    ends = [*corners.starts[1:], len(linear)]
    products = np.stack(
        [weighted[2 * i : 2 * j].T @ rows[2 * i : 2 * j] for i, j in zip(corners.starts, ends, strict=True)]
    )
    camera, pose = slice(0, -7), slice(-7, -1)
    return _Equations(
        A=products[:, camera, camera],
        B=products[:, camera, pose],
        C=products[:, pose, pose],
        a=products[:, camera, -1],
        c=products[:, pose, -1],
    )


def _expect(corners: Corners, fit: Fit) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Where the fit expects the corners (n, 2) px, (n, 2) before the lens, and (n, 3) m from the board's origin."""
    num_lens = 4 + COUNT[fit.lens]
    p_board = corners.p_board
    if corners.shapes.shape[2]:
        p_board = p_board + corners.shapes @ fit.numbers[num_lens:]
    turned = np.einsum("nij,nj->ni", fit.R_cam_board[corners.view], p_board)
    p = turned + fit.t_cam_board[corners.view]
    xy = np.clip(p[:, :2] / np.maximum(p[:, 2:], LEAST_DEPTH_M), -20.0, 20.0)
    return distort(fit.lens, xy, fit.numbers[4:num_lens]) * fit.numbers[:2] + fit.numbers[2:4], xy, turned


def _linearise(corners: Corners, fit: Fit) -> FloatArray:
    """(n, 2, k + 7) derivatives by the camera's k numbers and by the pose, and the residuals, expected minus seen."""
    num_lens, k = 4 + COUNT[fit.lens], len(fit.numbers)
    expected, xy, turned = _expect(corners, fit)
    z = np.maximum(turned[:, 2] + fit.t_cam_board[corners.view, 2], LEAST_DEPTH_M)
    lens = distortion_slopes(fit.lens, xy, fit.numbers[4:num_lens])
    focal = fit.numbers[:2]
    J_p = np.empty((len(xy), 2, 3))
    np.divide(focal[:, None] * lens.by_xy, z[:, None, None], out=J_p[:, :, :2])
    J_p[:, :, 2] = -(J_p[:, :, 0] * xy[:, :1] + J_p[:, :, 1] * xy[:, 1:])
    out = np.zeros((len(xy), 2, k + 7))
    out[:, :, :2] = ((expected - fit.numbers[2:4]) / focal)[:, :, None] * np.eye(2)
    out[:, 0, 2] = out[:, 1, 3] = 1.0
    out[:, :, 4:num_lens] = focal[:, None] * lens.by_d
    if corners.shapes.shape[2]:
        out[:, :, num_lens:k] = J_p @ fit.R_cam_board[corners.view] @ corners.shapes
    x, y, w = turned.T[:, :, None]
    out[:, :, k] = y * J_p[:, :, 2] - w * J_p[:, :, 1]  # row J_p times -[turned]x
    out[:, :, k + 1] = w * J_p[:, :, 0] - x * J_p[:, :, 2]
    out[:, :, k + 2] = x * J_p[:, :, 1] - y * J_p[:, :, 0]
    out[:, :, k + 3 : k + 6] = J_p
    out[:, :, -1] = expected - corners.uv_px
    return out
