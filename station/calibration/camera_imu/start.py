"""Where the batch estimate starts: the camera's poses, and time shift and mounting from its turning alone."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from shared.errors import DegenerateGeometry
from shared.geometry import FloatArray, se3, so3_exp, so3_log
from station.calibration.target import BoardView, Target
from station.vision.lens import Lens

MIN_CORNERS = 6
MAX_USED_S = 90.0
MAX_SHIFT_S = 0.5  # searched on both sides
SHIFT_STEP_S = 0.002
MAX_INTERVAL_S = 0.25  # between two images: more, and the turn between them says little of when
APART_S = 0.1  # another minimum of the search this far away is another answer


@dataclass(frozen=True, slots=True, eq=False)
class CameraPoses:
    t_s: FloatArray  # (V,) camera clock
    T_target_cam: FloatArray  # (V, 4, 4)
    rms_px: FloatArray  # (V,) how well each fits its corners
    views: list[BoardView]  # those that have a pose


def best_part(poses: CameraPoses, t_imu_s: FloatArray, gyro: FloatArray) -> CameraPoses:
    """Of a long recording the MAX_USED_S in which it turned most, about all axes, with the target in view.

    The memory of the batch estimate grows with the square of the time, and a minute tells nearly all.
    """
    rates = np.stack([np.interp(poses.t_s, t_imu_s, axis) for axis in gyro.T], axis=1)
    summed = np.concatenate([np.zeros((1, 3, 3)), np.cumsum(rates[:, :, None] * rates[:, None], axis=0)])
    after = np.searchsorted(poses.t_s, poses.t_s + MAX_USED_S, side="right")
    begin = int(np.argmax(np.linalg.det(summed[after] - summed[:-1])))
    used = slice(begin, int(after[begin]))
    return CameraPoses(poses.t_s[used], poses.T_target_cam[used], poses.rms_px[used], poses.views[used])


def camera_poses(views: list[BoardView], target: Target, lens: Lens, origin_ns: int) -> CameraPoses:
    """Each image's pose by itself. Source: Collins and Bartoli, Infinitesimal Plane-Based Pose Estimation, IJCV 2014.

    Of the two poses that a plane seen from far allows, the one that fits better.
    """
    corners = target.corners
    kept, poses, rms = [], [], []
    for view in views:
        if len(view.ids) < MIN_CORNERS:
            continue
        xy = lens.unproject(view.corners_px)
        board = corners[view.ids]
        found, turns, shifts, _ = cv2.solvePnPGeneric(board, xy, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE)
        if not found:
            continue
        candidates = []
        for turn, shift in zip(turns, shifts, strict=True):
            turn, shift = cv2.solvePnPRefineLM(board, xy, np.eye(3), None, turn, shift)
            R = so3_exp(np.asarray(turn, dtype=np.float64).ravel())
            p_cam = board @ R.T + shift.ravel()
            ahead = np.maximum(p_cam[:, 2:], 1e-3)
            error = lens.project(p_cam[:, :2] / ahead) - view.corners_px
            candidates.append((float(np.sqrt((error**2).mean())), R, shift.ravel()))
        best = min(candidates, key=lambda candidate: candidate[0])
        kept.append(view)
        rms.append(best[0])
        poses.append(se3(best[1].T, -best[1].T @ best[2]))
    t_s = np.array([1e-9 * (view.t_robot_ns - origin_ns) for view in kept])
    return CameraPoses(t_s, np.array(poses).reshape(-1, 4, 4), np.array(rms), kept)


@dataclass(frozen=True, slots=True, eq=False)
class TurningMatch:
    """The camera's turning laid over the gyroscope's."""

    shift_s: float  # from an image's stamp to the exposure of about its middle row, IMU clock
    R_body_cam: FloatArray  # (3, 3)
    gyro_bias: FloatArray  # (3,) rad/s
    unexplained: float  # share of the turning's variance, at the best shift
    runner_up: float  # the same at the best other minimum of the search; 1 where there is none
    rates: FloatArray  # (3,) rad/s, largest first: RMS angular rate along the principal axes of the turning
    axes_cam: FloatArray  # (3, 3) rows: those axes in the camera's frame


@dataclass(frozen=True, slots=True, eq=False)
class Turns:
    """By how much the camera turned between pairs of images."""

    begin_s: FloatArray  # (N,) camera clock
    end_s: FloatArray  # (N,)
    turns: FloatArray  # (N, 3) rad, rotation vector of R_begin_end, camera axes


def turns_between(poses: CameraPoses) -> Turns:
    """Of neighbouring images. Raises DegenerateGeometry: too few of them follow each other closely."""
    gap = np.diff(poses.t_s)
    near = gap < max(MAX_INTERVAL_S, 1.5 * float(np.median(gap))) if len(gap) else np.zeros(0, dtype=bool)
    if near.sum() < 8:
        raise DegenerateGeometry("too few images of the target follow each other closely")
    R = poses.T_target_cam[:, :3, :3]
    turns = so3_log(np.swapaxes(R[:-1], 1, 2) @ R[1:])[near]
    return Turns(poses.t_s[:-1][near], poses.t_s[1:][near], turns)


def match_turning(turned: Turns, t_imu_s: FloatArray, gyro: FloatArray) -> TurningMatch:
    """Time shift, mounting and bias with which the camera turns as the gyroscope says.

    Of each pair of images both say by how much the body turned. For every shift that is tried the best rotation
    and bias have a closed form (Kabsch), so that the search is over time alone.
    Raises:
        DegenerateGeometry: images and inertial readings do not overlap.
    """
    turns, begin, end = turned.turns, turned.begin_s, turned.end_s
    rate = 0.5 * (gyro[1:] + gyro[:-1])  # either reading alone would be half an interval early or late
    angle = np.concatenate([np.zeros((1, 3)), np.cumsum(rate * np.diff(t_imu_s)[:, None], axis=0)])
    shifts = np.arange(-MAX_SHIFT_S, MAX_SHIFT_S + 1e-9, SHIFT_STEP_S)
    matches = [_match_at(shift, turns, begin, end, t_imu_s, angle) for shift in shifts]
    cost = np.array([np.inf if match is None else match.unexplained for match in matches])
    if not np.isfinite(cost).any():
        raise DegenerateGeometry("images and inertial readings were not recorded at the same time")
    best = int(np.argmin(cost))
    found = matches[best]
    assert found is not None
    return replace(found, shift_s=_vertex(shifts, cost, best), runner_up=_other_minimum(shifts, cost, best))


def _match_at(
    shift_s: float, turns: FloatArray, begin: FloatArray, end: FloatArray, t_imu_s: FloatArray, angle: FloatArray
) -> TurningMatch | None:
    """None where fewer than half of the turns lie within the inertial readings."""
    inside = (begin + shift_s >= t_imu_s[0]) & (end + shift_s <= t_imu_s[-1])
    if 2 * inside.sum() < len(turns):
        return None
    begin, end, cam = begin[inside] + shift_s, end[inside] + shift_s, turns[inside]
    imu = np.stack([np.interp(end, t_imu_s, a) - np.interp(begin, t_imu_s, a) for a in angle.T], axis=1)
    seconds = (end - begin)[:, None]
    imu, cam = imu / seconds, cam / seconds
    weight = np.ones(len(cam))
    for _ in range(3):  # a flipped pose of a plane counts less and less
        mean_imu, mean_cam = (np.average(rates, axis=0, weights=weight) for rates in (imu, cam))
        a, b = imu - mean_imu, cam - mean_cam
        U, _, Vt = np.linalg.svd((a * weight[:, None]).T @ b)
        R = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
        error = ((a - b @ R.T) ** 2).sum(axis=1)
        weight = 1.0 / (1.0 + error / (3.0 * np.median(error) + 1e-12))
    unexplained = float((weight * error).sum() / (weight * (a**2).sum(axis=1)).sum())
    _, rates, axes = np.linalg.svd(a / np.sqrt(len(a)), full_matrices=False)
    return TurningMatch(shift_s, R, mean_imu - R @ mean_cam, unexplained, 1.0, rates, axes @ R)


def _vertex(shifts: FloatArray, cost: FloatArray, best: int) -> float:
    """Of the parabola through the best and its neighbours."""
    if not 0 < best < len(cost) - 1 or not np.isfinite(cost[best - 1 : best + 2]).all():
        return float(shifts[best])
    before, at, after = cost[best - 1 : best + 2]
    return float(shifts[best] + 0.5 * SHIFT_STEP_S * (before - after) / max(before - 2 * at + after, 1e-12))


def _other_minimum(shifts: FloatArray, cost: FloatArray, best: int) -> float:
    inner = np.arange(1, len(cost) - 1)
    lower = (cost[inner] <= cost[inner - 1]) & (cost[inner] <= cost[inner + 1])
    others = inner[lower & (np.abs(shifts[inner] - shifts[best]) > APART_S)]
    return float(cost[others].min()) if len(others) else 1.0
