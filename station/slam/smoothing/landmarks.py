"""All landmarks of one segment: where they are, how they looked, and which tracks show them."""

from __future__ import annotations

import numpy as np

from shared.geometry import FloatArray, IntArray
from station.slam.smoothing.recall import Patches
from station.vision.klt import TrackedFrame
from station.vision.lens import BoolArray

ROWS = 1024


class LandmarkTable:
    """Landmarks by number: that of the track which first showed them. Later tracks of the same are its other names."""

    def __init__(self, patch_side: int) -> None:
        self._row: dict[int, int] = {}
        self._other_name: dict[int, int] = {}
        self._count = 0
        self._side = patch_side
        self.number = np.zeros(0, dtype=np.int64)
        self.p_world = np.zeros((0, 3))
        self.cov = np.zeros((0, 3, 3))  # given the poses it was triangulated from
        self.last_seen = np.zeros(0, dtype=np.int64)  # keyframe
        self.is_bad = np.zeros(0, dtype=bool)
        self._grey = np.zeros((0, patch_side, patch_side), dtype=np.uint8)
        self._offset, self._uv, self._T = np.zeros((0, 2)), np.zeros((0, 2)), np.zeros((0, 4, 4))

    def __len__(self) -> int:
        return self._count

    def __contains__(self, number: int) -> bool:
        return number in self._row

    def row(self, number: int) -> int:
        return self._row[number]

    def rows(self, numbers: IntArray) -> IntArray:
        """(n,) the rows of landmarks; -1 for tracks that are none yet."""
        return np.array([self._row.get(int(i), -1) for i in numbers], dtype=np.int64)

    def rename(self, track: int, landmark: int) -> None:
        """From now on this track shows that landmark."""
        self._other_name[track] = landmark

    def named(self, tracked: TrackedFrame) -> TrackedFrame:
        """The frame with tracks called by the landmarks they show; of two that show the same, the first stays."""
        names = np.array([self._other_name.get(int(i), int(i)) for i in tracked.ids], dtype=np.int64)
        _, first = np.unique(names, return_index=True)
        keep = np.sort(first)
        uv_px, xy = tracked.uv_px[keep], tracked.xy[keep]
        return TrackedFrame(names[keep], uv_px, xy, tracked.num_tracked, tracked.brightness)

    def add(self, numbers: IntArray, p_world: FloatArray, cov: FloatArray, patches: Patches, keyframe: int) -> None:
        """New landmarks, as they looked in their newest view."""
        n, m = self._count, len(numbers)
        if n + m > len(self.number):
            more = max(ROWS, m)
            for name in ("number", "p_world", "cov", "last_seen", "is_bad", "_grey", "_offset", "_uv", "_T"):
                old = getattr(self, name)
                setattr(self, name, np.concatenate([old, np.zeros((more, *old.shape[1:]), old.dtype)]))
        at = slice(n, n + m)
        self.number[at], self.p_world[at], self.cov[at], self.last_seen[at] = numbers, p_world, cov, keyframe
        self.is_bad[at] = False
        self._grey[at], self._offset[at] = patches.grey, patches.offset
        self._uv[at], self._T[at] = patches.uv_px, patches.T_world_cam
        self._row.update({int(k): n + i for i, k in enumerate(numbers)})
        self._count = n + m

    def look_again(self, rows: IntArray, patches: Patches) -> None:
        """Newer patches of landmarks."""
        self._grey[rows], self._offset[rows] = patches.grey, patches.offset
        self._uv[rows], self._T[rows] = patches.uv_px, patches.T_world_cam

    def patches(self, rows: IntArray) -> Patches:
        return Patches(self._grey[rows], self._offset[rows], self._uv[rows], self._T[rows])

    def seen_from(self, rows: IntArray) -> FloatArray:
        """(n, 3) centres of the cameras in whose views the patches were cut."""
        return self._T[rows, :3, 3]

    def lost(self, seen_numbers: IntArray) -> IntArray:
        """Rows of the good landmarks that are not among these."""
        gone: BoolArray = ~np.isin(self.number[: self._count], seen_numbers)
        return np.flatnonzero(gone & ~self.is_bad[: self._count])
