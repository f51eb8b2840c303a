"""Where a simulated robot was, for judges: on the disk, so that a robot that runs for hours takes no more memory."""

from __future__ import annotations

import logging
import os
import tempfile
import weakref

import numpy as np

from shared.disk import spill_folder
from shared.geometry import FloatArray

logger = logging.getLogger(__name__)

ROW = np.dtype([("t_robot_ns", "<i8"), ("T_world_body", "<f8", (4, 4))])


class TruthLog:
    """Times and poses in a file without a name; when it is full, the oldest go. One writer at a time."""

    def __init__(self, max_rows: int) -> None:
        self._max_rows = max_rows
        self._count = 0
        with tempfile.TemporaryFile(prefix="sentinel-truth-", buffering=0, dir=spill_folder()) as file:
            self._file = os.dup(file.fileno())
        weakref.finalize(self, os.close, self._file)
        self._is_full_disk = False

    def append(self, t_robot_ns: int, T_world_body: FloatArray) -> None:
        """A pose (4, 4). Where the disk is full the log ends there: the robot moves on."""
        if self._is_full_disk:
            return
        row = np.array((t_robot_ns, T_world_body), ROW).tobytes()
        try:
            os.pwrite(self._file, row, self._count % self._max_rows * ROW.itemsize)
        except OSError as exc:
            self._is_full_disk = True
            logger.warning("the true poses are logged no longer (%s)", exc.strerror)
        else:
            self._count += 1

    def read(self) -> list[tuple[int, FloatArray]]:
        """All that is kept, the oldest first."""
        num_rows = min(self._count, self._max_rows)
        rows = np.frombuffer(os.pread(self._file, num_rows * ROW.itemsize, 0), ROW)
        if self._count > self._max_rows:
            rows = np.roll(rows, -(self._count % self._max_rows))
        return list(zip(rows["t_robot_ns"].tolist(), rows["T_world_body"], strict=True))
