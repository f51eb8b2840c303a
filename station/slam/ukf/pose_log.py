"""The poses of all frames, improved as more becomes known."""

from __future__ import annotations

import numpy as np

from shared.geometry import FloatArray, IntArray, inverse
from station.slam.ukf import lie


class PoseLog:
    """One pose per tracked frame, in time order; times are the IMU's, since poses are the body's."""

    def __init__(self) -> None:
        self._index: list[int] = []  # frame indices, ascending
        self._t: list[int] = []
        self._T: list[FloatArray] = []
        self._segment: list[int] = []
        self._row: dict[int, int] = {}

    def __len__(self) -> int:
        return len(self._t)

    def add(self, frame_index: int, t_imu_ns: int, T_world_body: FloatArray, segment: int) -> None:
        if frame_index in self._row or (self._t and t_imu_ns <= self._t[-1]):
            return
        self._row[frame_index] = len(self._t)
        self._index.append(frame_index)
        self._t.append(t_imu_ns)
        self._T.append(T_world_body)
        self._segment.append(segment)

    def improve(self, frame_index: int, T_world_body: FloatArray) -> None:
        """A later estimate of a pose that is already there."""
        row = self._row.get(frame_index)
        if row is not None:
            self._T[row] = T_world_body

    def last(self) -> FloatArray | None:
        return self._T[-1] if self._T else None

    def drop_after(self, t_imu_ns: int, segment: int) -> None:
        """Forget this segment's poses from a time on: they were dead reckoning into the unknown."""
        while self._t and self._t[-1] >= t_imu_ns and self._segment[-1] == segment:
            del self._row[self._index[-1]]
            for column in (self._index, self._t, self._T, self._segment):
                column.pop()

    def follow(self, frame_index: list[int], T_old: FloatArray, T_new: FloatArray, segment: int) -> None:
        """Move all poses of a segment as their keyframes (F, 4, 4) moved, blending between the two around them."""
        known = [(self._row[i], k) for k, i in enumerate(frame_index) if i in self._row]
        rows = np.flatnonzero(np.array(self._segment) == segment)
        if not known or not len(rows):
            return
        at = [k for _, k in known]
        T = np.array([self._T[row] for row in rows.tolist()])
        t = np.array(self._t, dtype=np.int64)
        moved = follow_poses(T, t[rows], T_old[at], T_new[at], t[[row for row, _ in known]])
        for row, pose in zip(rows.tolist(), moved, strict=True):
            self._T[row] = pose

    def arrays(self) -> tuple[IntArray, FloatArray]:
        """Times (N,) and poses (N, 4, 4)."""
        return np.array(self._t, dtype=np.int64), np.array(self._T).reshape(-1, 4, 4)


def follow_poses(T: FloatArray, t_ns: IntArray, T_old: FloatArray, T_new: FloatArray, t_key_ns: IntArray) -> FloatArray:
    """Poses T (N, 4, 4) at t_ns moved as the F keyframes moved that are around them, blending between the two.

    Args:
        T_old, T_new: (F, 4, 4) the keyframes' poses before and after.
        t_key_ns: (F,) ascending.
    """
    correction = T_new @ inverse(T_old)
    if len(correction) == 1:
        return np.asarray(correction[0] @ T)
    right = np.clip(np.searchsorted(t_key_ns, t_ns), 1, len(t_key_ns) - 1)
    left = right - 1
    w = np.clip((t_ns - t_key_ns[left]) / (t_key_ns[right] - t_key_ns[left]), 0.0, 1.0)[:, None]
    a, b = correction[left] @ T, correction[right] @ T
    between = lie.so3_log(np.swapaxes(a[:, :3, :3], 1, 2) @ b[:, :3, :3])
    a[:, :3, :3] = a[:, :3, :3] @ lie.so3_exp(w * between)
    a[:, :3, 3] = (1.0 - w) * a[:, :3, 3] + w * b[:, :3, 3]
    return np.asarray(a)
