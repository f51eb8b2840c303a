"""The map's views in the problem of keyframes and landmarks, when the drive has ended (docs/slam.md, "Smoothing")."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from shared.errors import DegenerateGeometry
from shared.geometry import FloatArray, inverse
from station.slam.mapping.inertial_graph import reprojection_factor, to_pose
from station.slam.mapping.odometry_bundle import BundleState, Observations
from station.slam.smoothing.batch import GATES, BatchInput, SegmentProblem, thinned
from station.slam.smoothing.keyframe import SmoothKeyframe


class ViewAdjuster:
    """An `Adjuster` (mapping/odometry_mapping.py) of one segment's views: loops that they close pull at everything.

    A view is a frame between two keyframes: its camera is fixed to the one before it.
    """

    def __init__(
        self, part: list[SmoothKeyframe], given: BatchInput, frame_index: Sequence[int], T_world_body: FloatArray
    ) -> None:
        """Args:
        part: as smoothed without the views.
        frame_index, T_world_body: (N,), (N, 4, 4) of the views, as known by that.
        """
        self._keyframes = [replace(k) for k in thinned(part, given.config.max_keyframes)]
        self._given = given
        frame = np.array([k.source.frame.index for k in self._keyframes])
        self._before = np.maximum(np.searchsorted(frame, frame_index, side="right") - 1, 0)
        T_world_before = np.array([self._keyframes[k].T_world_body for k in self._before])
        self._T_before_view = inverse(T_world_before) @ T_world_body

    def __call__(self, state: BundleState, seen: Observations, scale_px: float) -> BundleState:
        """The views' poses by all that is known; as they were where the equations have no single solution."""
        problem = SegmentProblem(self._keyframes, GATES[-1], self._given)
        self._add_views(problem, state, seen, scale_px)
        try:
            problem.solve()
        except DegenerateGeometry:
            return state
        T = np.array([self._keyframes[k].T_world_body for k in self._before]) @ self._T_before_view
        return replace(state, R_world_body=T[:, :3, :3], p_world_body=T[:, :3, 3])

    def _add_views(self, problem: SegmentProblem, state: BundleState, seen: Observations, scale_px: float) -> None:
        first = problem.num_landmarks
        for m, p in enumerate(state.points):
            problem.add_landmark(first + m, p)
        T_before_cam = [to_pose(T) for T in self._T_before_view @ inverse(seen.T_cam_body)]
        number = [self._keyframes[k].number for k in self._before]
        sigma = 1.0 / seen.focal_px
        for view, m, xy in zip(seen.keyframe.tolist(), seen.point.tolist(), seen.xy, strict=True):
            problem.graph.push_back(
                reprojection_factor(number[view], first + m, xy, sigma, scale_px, T_before_cam[view])
            )
