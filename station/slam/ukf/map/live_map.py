"""Landmarks while the robot drives: tracks that ended, triangulated from the filter's keyframes."""

from __future__ import annotations

import numpy as np

from shared.geometry import FloatArray, IntArray
from station.slam.ukf.filter.state import FilterState
from station.slam.ukf.map.keyframes import Keyframe
from station.slam.ukf.map.landmark_map import MAX_VIEWS, LandmarkQuality, TrackObservations, triangulate_tracks
from station.vision.camera_model import CameraModel


class LiveMap:
    """For the live view; finish() makes the lasting landmarks. Holds the last MAX_VIEWS keyframes only."""

    def __init__(self, camera: CameraModel, quality: LandmarkQuality) -> None:
        self._camera, self._quality = camera, quality
        self._recent: list[Keyframe] = []
        self._entered: dict[int, tuple[FloatArray, FloatArray]] = {}
        self.count = 0

    def add(self, keyframe: Keyframe) -> tuple[FloatArray, FloatArray] | None:
        """Points (n, 3) and colours (n, 3) of the tracks that ended before this keyframe; None for none."""
        if self._recent and self._recent[-1].segment != keyframe.segment:
            self._recent = []
        if not self._recent:
            self._recent = [keyframe]
            return None
        ended = np.setdiff1d(self._recent[-1].tracked.ids, keyframe.tracked.ids)
        table = TrackObservations.of(self._recent)
        table = table.select(np.isin(table.track, ended))
        ids, points = triangulate_tracks(self._recent, table, self._camera)
        self._recent = [*self._recent, keyframe][-MAX_VIEWS:]
        quality = self._quality
        good = points.is_good & (points.rms < quality.max_rms) & (points.depth_sigma < quality.max_depth_sigma)
        if not good.any():
            return None
        first = np.searchsorted(table.track, ids[good])
        self.count += int(good.sum())
        return points.p[good], table.rgb[first].astype(np.float64)

    def entered(self, ids: IntArray, state: FilterState) -> None:
        """Landmarks that have just entered the filter (thesis: saved at that moment)."""
        for i in np.flatnonzero(np.isin(state.landmark_id, ids)).tolist():
            rows = state.landmark_rows(i)
            S = state.S[rows]
            self._entered.setdefault(int(state.landmark_id[i]), (state.landmark_p[i].copy(), S @ S.T))

    def as_entered(self) -> tuple[IntArray, FloatArray, FloatArray]:
        """Ids (M,) ascending, positions (M, 3), covariances (M, 3, 3) of the landmarks as they entered."""
        ids = sorted(self._entered)
        p = np.array([self._entered[i][0] for i in ids]).reshape(-1, 3)
        cov = np.array([self._entered[i][1] for i in ids]).reshape(-1, 3, 3)
        return np.array(ids, dtype=np.int64), p, cov
