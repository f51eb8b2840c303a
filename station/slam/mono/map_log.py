"""What stays of a navigation: poses, keyframes with their pictures, and the last word on every feature."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from shared.geometry import FloatArray, IntArray, transform
from station.files.spill import Spill, SpilledFiles
from station.model.frames import ImageFrame
from station.model.navigation import Keyframes, Landmarks
from station.slam.mapping.assemble import make_keyframes, make_landmarks
from station.slam.mono.config import MonoConfig
from station.slam.mono.motion import POSITION
from station.slam.mono.state import State


class MapLog:
    def __init__(self, config: MonoConfig, width_px: int) -> None:
        self._config = config
        self._width_px = width_px
        self.poses: dict[int, FloatArray] = {}  # by time of the image, ns: T_world_cam
        self._frames: list[ImageFrame] = []  # keyframes, without their files
        self.encoded = SpilledFiles(Spill())  # these
        self._segments: list[int] = []
        self._seen: list[tuple[IntArray, FloatArray]] = []  # ids and pixels, one pair a keyframe
        self._points: dict[int, tuple[FloatArray, FloatArray]] = {}  # by id: where, and covariance

    def is_keyframe(self, ids: IntArray, uv_px: FloatArray, segment: int) -> bool:
        """Whether half of the last keyframe's features have moved, or are gone."""
        if not self._segments or self._segments[-1] != segment:
            return True
        then, uv_then = self._seen[-1]
        _, now, before = np.intersect1d(ids, then, assume_unique=True, return_indices=True)
        flow = np.linalg.norm(uv_px[now] - uv_then[before], axis=1)
        return int((flow < self._config.keyframe_flow * self._width_px).sum()) < 0.5 * len(then)

    def add_keyframe(self, frame: ImageFrame, segment: int, ids: IntArray, uv_px: FloatArray) -> None:
        self._frames.append(replace(frame, encoded=b""))
        self.encoded.append(frame.encoded)
        self._segments.append(segment)
        self._seen.append((ids, uv_px))

    def note(self, state: State, T_world_filter: FloatArray) -> None:
        """Keep the features of this state whose place is known well enough."""
        p, cov = state.points()
        away = np.linalg.norm(p - state.x[POSITION], axis=1)
        known = np.sqrt(np.trace(cov, axis1=1, axis2=2)) < self._config.max_depth_sigma * away
        R = T_world_filter[:3, :3]
        for i in np.flatnonzero(known).tolist():
            self._points[int(state.ids[i])] = transform(T_world_filter, p[i]), R @ cov[i] @ R.T

    def map(self) -> tuple[Keyframes, Landmarks]:
        """Keyframes, and of the features whose place is known those that enough of them saw."""
        frames = [replace(f, encoded=e) for f, e in zip(self._frames, self.encoded, strict=True)]
        keyframes = make_keyframes(frames, np.array([self.poses[frame.t_robot_ns] for frame in frames]))
        keyframes = replace(keyframes, segment=np.array(self._segments, dtype=np.int64))
        ids = np.array(sorted(self._points), dtype=np.int64)
        points = np.array([self._points[i][0] for i in ids.tolist()]).reshape(-1, 3)
        cov = np.array([self._points[i][1] for i in ids.tolist()]).reshape(-1, 3, 3)
        seen, uv = (np.concatenate(each) for each in zip(*self._seen, strict=True))
        seen_from = np.repeat(np.arange(len(self._seen)), [len(seen) for seen, _ in self._seen])
        known = np.isin(seen, ids)
        owner = np.searchsorted(ids, seen[known])
        keep = np.bincount(owner, minlength=len(ids)) >= self._config.min_observations
        return keyframes, make_landmarks(keyframes, keep, points, cov, owner, seen_from[known], uv[known])
