"""Poses between those that are known."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from shared.geometry import FloatArray, IntArray, se3, slerp
from station.model.navigation import DepthScans

MAX_GAP_NS = 100_000_000  # poses further apart than this are not interpolated
MAX_SCAN_GAP_NS = 200_000_000  # ... to say where a depth sensor was: a slow camera's poses are further apart


class Poses(Protocol):
    """Trajectory, Truth: anything with poses over time."""

    @property
    def t_robot_ns(self) -> IntArray: ...  # (N,) increasing

    @property
    def T_world_body(self) -> FloatArray: ...  # (N, 4, 4)


def interpolate_poses(poses: Poses, t_ns: IntArray, max_gap_ns: int = MAX_GAP_NS) -> tuple[FloatArray, IntArray]:
    """Poses (M, 4, 4) at times, linear in position and along the rotation, and the indices (M,) of the times covered.

    Times outside of the poses, or in a gap longer than max_gap_ns, are left out.
    """
    known = np.asarray(poses.t_robot_ns)
    T = poses.T_world_body
    out, kept = [], []
    for i, t in enumerate(np.asarray(t_ns).tolist()):
        after = int(np.searchsorted(known, t))
        if after < len(known) and known[after] == t:
            out.append(T[after])
        elif 0 < after < len(known) and known[after] - known[after - 1] <= max_gap_ns:
            fraction = float((t - known[after - 1]) / (known[after] - known[after - 1]))
            out.append(between(T[after - 1], T[after], fraction))
        else:
            continue
        kept.append(i)
    return np.array(out).reshape(-1, 4, 4), np.array(kept, dtype=np.int64)


def scan_poses(poses: Poses, scans: DepthScans) -> tuple[FloatArray, IntArray]:
    """The body's poses (M, 4, 4) at the times of depth scans, and which scans (M,) have one."""
    return interpolate_poses(poses, scans.t_robot_ns, MAX_SCAN_GAP_NS)


def between(T_a: FloatArray, T_b: FloatArray, fraction: float) -> FloatArray:
    """The pose at a fraction (0..1) of the way from a to b."""
    R = slerp(T_a[:3, :3], T_b[:3, :3], fraction)
    return se3(R, (1.0 - fraction) * T_a[:3, 3] + fraction * T_b[:3, 3])
