"""The poses of all frames, improved as more becomes known."""

from __future__ import annotations

import numpy as np

from shared.geometry import FloatArray, IntArray, inverse, slerp

ROWS = 4096  # by which the table grows: three minutes


class PoseLog:
    """One pose per tracked frame, in time order; times are the IMU's, since poses are the body's.

    A table, since this is what grows as long as the robot drives: an array per pose would take three times the memory.
    """

    def __init__(self) -> None:
        self._length = 0
        self._index = np.empty(0, dtype=np.int64)  # frame indices, ascending
        self._t = np.empty(0, dtype=np.int64)
        self._segment = np.empty(0, dtype=np.int64)
        self._T = np.empty((0, 4, 4))

    def __len__(self) -> int:
        return self._length

    def add(self, frame_index: int, t_imu_ns: int, T_world_body: FloatArray, segment: int) -> None:
        """A frame that is not later than the last one is left out."""
        n = self._length
        if n and (frame_index <= self._index[n - 1] or t_imu_ns <= self._t[n - 1]):
            return
        if n == len(self._t):
            self._index, self._t, self._segment, self._T = (
                np.concatenate([column, np.empty((ROWS, *column.shape[1:]), column.dtype)])
                for column in (self._index, self._t, self._segment, self._T)
            )
        self._index[n], self._t[n], self._segment[n], self._T[n] = frame_index, t_imu_ns, segment, T_world_body
        self._length = n + 1

    def improve(self, frame_index: int, T_world_body: FloatArray) -> None:
        """A later estimate of a pose that is already there."""
        row = self._row(frame_index)
        if row is not None:
            self._T[row] = T_world_body

    def pose_of(self, frame_index: int) -> FloatArray | None:
        """(4, 4); None of a frame without a pose."""
        row = self._row(frame_index)
        return None if row is None else self._T[row].copy()

    def last(self) -> FloatArray | None:
        return self._T[self._length - 1].copy() if self._length else None

    def drop_after(self, t_imu_ns: int, segment: int) -> None:
        """Forget this segment's poses from a time on: they were dead reckoning into the unknown."""
        while self._length and self._t[self._length - 1] >= t_imu_ns and self._segment[self._length - 1] == segment:
            self._length -= 1

    def follow(self, frame_index: list[int], T_old: FloatArray, T_new: FloatArray, segment: int) -> None:
        """Move all poses of a segment as their keyframes (F, 4, 4) moved, blending between the two around them."""
        known = [(row, k) for k, i in enumerate(frame_index) if (row := self._row(i)) is not None]
        rows = np.flatnonzero(self._segment[: self._length] == segment)
        if not known or not len(rows):
            return
        at = [k for _, k in known]
        t_key_ns = self._t[[row for row, _ in known]]
        self._T[rows] = follow_poses(self._T[rows], self._t[rows], T_old[at], T_new[at], t_key_ns)

    def arrays(self) -> tuple[IntArray, FloatArray]:
        """Times (N,) and poses (N, 4, 4)."""
        return self._t[: self._length].copy(), self._T[: self._length].copy()

    def _row(self, frame_index: int) -> int | None:
        row = int(np.searchsorted(self._index[: self._length], frame_index))
        return row if row < self._length and self._index[row] == frame_index else None


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
    w = np.clip((t_ns - t_key_ns[left]) / (t_key_ns[right] - t_key_ns[left]), 0.0, 1.0)
    a, b = correction[left] @ T, correction[right] @ T
    a[:, :3, :3] = slerp(a[:, :3, :3], b[:, :3, :3], w)
    a[:, :3, 3] = (1.0 - w)[:, None] * a[:, :3, 3] + w[:, None] * b[:, :3, 3]
    return np.asarray(a)
