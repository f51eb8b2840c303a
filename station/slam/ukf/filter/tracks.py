"""Observations of the tracks in the window of cloned poses."""

from __future__ import annotations

import numpy as np

from shared.geometry import FloatArray, IntArray
from station.vision.klt import TrackedFrame
from station.vision.lens import BoolArray


class TrackTable:
    """Row per track (ids ascend), column per clone. Columns follow the filter's clones."""

    def __init__(self) -> None:
        self.ids: IntArray = np.zeros(0, dtype=np.int64)
        self.uv_px: FloatArray = np.zeros((0, 0, 2))
        self.xy: FloatArray = np.zeros((0, 0, 2))
        self.seen: BoolArray = np.zeros((0, 0), dtype=bool)

    def add_frame(self, frame: TrackedFrame, excluded: IntArray) -> None:
        """Append a column with this frame's observations, except of the excluded tracks."""
        order = np.argsort(frame.ids, kind="stable")
        order = order[~np.isin(frame.ids[order], excluded)]
        ids = frame.ids[order]
        new = ids[~np.isin(ids, self.ids)]
        all_ids = np.concatenate([self.ids, new])  # new ids are larger than any known one, unless restarted
        by_id = np.argsort(all_ids, kind="stable")
        rows, columns = len(all_ids), self.seen.shape[1]
        uv, xy = np.zeros((2, rows, columns + 1, 2))
        seen = np.zeros((rows, columns + 1), bool)
        old = len(self.ids)
        uv[:old, :columns], xy[:old, :columns], seen[:old, :columns] = self.uv_px, self.xy, self.seen
        self.ids, uv, xy, seen = all_ids[by_id], uv[by_id], xy[by_id], seen[by_id]
        row = np.searchsorted(self.ids, ids)
        uv[row, -1], xy[row, -1], seen[row, -1] = frame.uv_px[order], frame.xy[order], True
        self.uv_px, self.xy, self.seen = uv, xy, seen

    def remove_column(self, index: int) -> None:
        keep = np.arange(self.seen.shape[1]) != index
        self.uv_px, self.xy, self.seen = self.uv_px[:, keep], self.xy[:, keep], self.seen[:, keep]
        self.keep_rows(np.asarray(self.seen.any(axis=1)))

    def keep_rows(self, keep: BoolArray) -> None:
        self.ids, self.uv_px, self.xy, self.seen = self.ids[keep], self.uv_px[keep], self.xy[keep], self.seen[keep]

    def drop_all_rows(self) -> None:
        """Forget all tracks; the columns stay."""
        self.keep_rows(np.zeros(len(self.ids), dtype=bool))
