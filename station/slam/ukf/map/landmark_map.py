"""Landmarks for places: every good track, triangulated from the keyframes (docs/slam.md, sec. 10)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from shared.geometry import FloatArray, IntArray
from station.model.navigation import Landmarks
from station.slam.mapping.rolling_shutter import observation_pose
from station.slam.ukf.filter.state import FilterState
from station.slam.ukf.map.keyframes import Keyframe
from station.vision.camera_model import CameraModel
from station.vision.lens import BoolArray
from station.vision.triangulation import Triangulation, triangulate

MIN_VIEWS = 3
MAX_VIEWS = 24  # per landmark; more add little
CHUNK = 2000


@dataclass(frozen=True, slots=True)
class LandmarkQuality:
    """What a landmark must be to enter the map."""

    max_rms: float = 2.0  # whitened reprojection error
    max_depth_sigma: float = 0.15  # relative


@dataclass(frozen=True, slots=True, eq=False)
class TrackObservations:
    """Flat table of what the keyframes saw, sorted by track."""

    track: IntArray  # (K,)
    keyframe: IntArray  # (K,)
    uv_px: FloatArray  # (K, 2)
    xy: FloatArray  # (K, 2)
    rgb: npt.NDArray[np.uint8]  # (K, 3)

    @classmethod
    def of(cls, keyframes: list[Keyframe]) -> TrackObservations:
        if not keyframes:
            none, empty = np.zeros(0, dtype=np.int64), np.zeros((0, 2))
            return cls(none, none, empty, empty, np.zeros((0, 3), dtype=np.uint8))
        track = np.concatenate([k.tracked.ids for k in keyframes])
        index = np.concatenate([np.full(len(k.tracked.ids), i) for i, k in enumerate(keyframes)])
        order = np.lexsort((index, track))
        return cls(
            track[order],
            index[order],
            np.concatenate([k.tracked.uv_px for k in keyframes])[order],
            np.concatenate([k.tracked.xy for k in keyframes])[order],
            np.concatenate([k.rgb for k in keyframes])[order],
        )

    def select(self, keep: BoolArray) -> TrackObservations:
        return TrackObservations(self.track[keep], self.keyframe[keep], self.uv_px[keep], self.xy[keep], self.rgb[keep])


def triangulate_with_covariance(
    keyframes: list[Keyframe], observations: TrackObservations, camera: CameraModel, late_s: float = 0.0
) -> tuple[IntArray, Triangulation]:
    """Track ids (F,) with enough views, and their points with covariances: also the bad ones, which say so.

    `late_s`: so much later than the keyframes' poses the images were taken.
    """
    ids, start, count = np.unique(observations.track, return_index=True, return_counts=True)
    enough = count >= MIN_VIEWS
    ids, start, count = ids[enough], start[enough], count[enough]
    if not len(ids):
        empty = np.zeros(0)
        nothing = Triangulation(np.zeros((0, 3)), np.zeros(0, dtype=bool), empty, empty, np.zeros((0, 3, 3)))
        return ids.astype(np.int64), nothing
    R = np.array([k.T_world_head[:3, :3] for k in keyframes])
    x = np.array([k.T_world_head[:3, 3] for k in keyframes])
    v = np.array([k.v_world for k in keyframes])
    omega = np.array([k.omega_head for k in keyframes])
    parts = []
    for first in range(0, len(ids), CHUNK):
        s, c = start[first : first + CHUNK], count[first : first + CHUNK]
        M = int(min(c.max(), MAX_VIEWS))
        # Evenly spread views where there are more than M.
        slots = np.arange(M)
        use = np.minimum(c, M)
        at = np.rint(slots[None] * (c - 1)[:, None] / np.maximum(use - 1, 1)[:, None]).astype(int)
        seen = slots[None] < use[:, None]
        row = np.where(seen, s[:, None] + at, s[:, None])
        kf, uv, xy = observations.keyframe[row], observations.uv_px[row], observations.xy[row]
        R_obs, x_obs = R[kf], x[kf]
        if camera.line_delay_s or late_s:
            R_obs, x_obs = observation_pose(R_obs, x_obs, v[kf], omega[kf], camera.row_delay_s(uv[..., 1]) + late_s)
        parts.append(triangulate(camera, R_obs, x_obs, xy, seen, 6))
    points = Triangulation(
        p=np.concatenate([t.p for t in parts]),
        is_good=np.concatenate([t.is_good for t in parts]),
        depth_sigma=np.concatenate([t.depth_sigma for t in parts]),
        rms=np.concatenate([t.rms for t in parts]),
        cov=np.concatenate([t.cov for t in parts]),
    )
    return ids, points


def make_landmarks(
    keyframes: list[Keyframe],
    camera: CameraModel,
    quality: LandmarkQuality,
    late_s: float = 0.0,
) -> Landmarks:
    """All tracks of the keyframes that are good enough, as the map's landmarks."""
    observations = TrackObservations.of(keyframes)
    ids, points = triangulate_with_covariance(keyframes, observations, camera, late_s)
    good = points.is_good & (points.rms < quality.max_rms) & (points.depth_sigma < quality.max_depth_sigma)
    return assemble(ids[good], points.p[good], points.cov[good], observations)


def assemble(
    ids: IntArray,
    p: FloatArray,
    cov: FloatArray,
    observations: TrackObservations,
) -> Landmarks:
    """Landmarks with all their observations in keyframes; ids ascend."""
    place = np.searchsorted(ids, observations.track)
    known = np.zeros(len(observations.track), dtype=bool)
    if len(ids):
        known = ids[np.minimum(place, len(ids) - 1)] == observations.track
    place, seen = place[known], observations.select(known)
    rgb = np.full((len(ids), 3), 128, dtype=np.uint8)
    owner, first = np.unique(place, return_index=True)
    rgb[owner] = seen.rgb[first]
    return Landmarks(
        p_world=p,
        rgb=rgb,
        cov_world=cov,
        observed_landmark=place.astype(np.int64),
        observed_keyframe=seen.keyframe,
        observed_uv_px=seen.uv_px,
    )


class LiveMap:
    """Landmarks while the robot drives: tracks that ended, triangulated from the filter's keyframes, for the live view.

    finish() makes the lasting ones. Holds the last MAX_VIEWS keyframes only."""

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
        ids, points = triangulate_with_covariance(self._recent, table, self._camera)
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
