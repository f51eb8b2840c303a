"""A map by depth against the depth itself, placed by true poses: its scale, and the walls of its plan. Judges only."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from shared.errors import DegenerateGeometry
from shared.geometry import FloatArray, inverse_sim3, se3, transform
from station.datasets import Truth
from station.experiments.alignment import Alignment, align_most_points
from station.model.floor_plan import FloorPlan
from station.model.navigation import Keyframes, Landmarks, Navigation, Trajectory
from station.motion.interpolation import scan_poses
from station.places.rooms.plan import plan_along
from station.places.rooms.surfaces import ON_M, Seen
from station.places.rooms.wall_model import wall_model
from station.places.space.space import Cells
from station.slam.mapping.depth import measured_landmarks

AGREE = 0.1  # log of measured depth by the map's: beyond, the landmark is not what was measured
PIECE_M = 0.1  # of a wall, judged by itself
SAME_WALL_M = 0.5  # a wall that is farther is another one
SLACK_M = 0.2  # by which a wall may be shorter in one plan


@dataclass(frozen=True, slots=True, eq=False)
class WallOffsets:
    """How far the pieces of a plan's walls are from the depth's own walls."""

    offset_m: FloatArray  # (n,) of the pieces that have one beside them
    is_measured: Cells  # (n,) whether depth has points on that one, beside the piece; else no wall was in view there
    pieces: int  # all

    def results(self) -> dict[str, float | int | None]:
        size = np.abs(self.offset_m)
        measured = size[self.is_measured]
        return {
            "measured_m": len(measured) * PIECE_M,
            "measured_within_5_cm": float((measured <= 0.05).mean()) if len(measured) else None,
            "length_m": self.pieces * PIECE_M,
            "found": len(size) / self.pieces if self.pieces else None,
            "median_m": float(np.median(size)) if len(size) else None,
            "greatest_m": float(size.max()) if len(size) else None,
            "within_5_cm": float((size <= 0.05).sum() / self.pieces) if self.pieces else None,
        }


def align_by_depth(navigation: Navigation, truth: Truth) -> Alignment:
    """The similarity from a map to the truth's world, by its landmarks: where depth has them from true poses.

    Landmarks reach through the whole room, a path often through a corner of it: its scale also tells how well a map
    parts turning from moving. Raises DegenerateGeometry where depth shows too few.
    """
    depth = navigation.depth
    if depth is None:
        raise DegenerateGeometry("the navigation has no depth")
    T_truth_body, kept = scan_poses(truth, depth)
    pose_of = dict(zip(kept.tolist(), T_truth_body, strict=True))
    in_map, in_truth = [np.empty((0, 3))], [np.empty((0, 3))]
    for seen in measured_landmarks(navigation, depth, 1.0):
        if seen.scan in pose_of:
            rows = np.flatnonzero(np.abs(seen.log_ratios) < AGREE)
            p_depth = seen.p_depth[rows] * (seen.measured_m[rows] / seen.p_depth[rows, 2])[:, None]
            in_truth.append(transform(pose_of[seen.scan] @ depth.sensor.T_body_depth_matrix, p_depth))
            in_map.append(navigation.landmarks.p_world[seen.landmark[rows]])
    return align_most_points(np.concatenate(in_truth), np.concatenate(in_map))


def wall_offsets(navigation: Navigation, plan: FloorPlan, truth: Truth) -> WallOffsets:
    """The plan's walls beside those of a plan by depth alone, from true poses and in the same axes.

    What depth measured is carried onto the map without scaling, so that an error of the map's scale shows.
    """
    depth_alone = _depth_alone(navigation, truth)
    by_depth = plan_along(plan.R_ground_map, depth_alone, (), wall_model())
    p = Seen.of(depth_alone, plan.R_ground_map).p * by_depth.unit
    theirs = [_along_axis(wall) for wall in by_depth.walls]
    offsets: list[float] = []
    measured: list[bool] = []
    pieces = 0
    for axis, at, low, high in map(_along_axis, plan.walls):
        for middle in np.arange(low + 0.5 * PIECE_M, high, PIECE_M):
            pieces += 1
            beside = [its - at for a, its, b, e in theirs if a == axis and b - SLACK_M <= middle <= e + SLACK_M]
            nearest = min(beside, key=abs, default=np.inf)
            if abs(nearest) <= SAME_WALL_M:
                offsets.append(float(nearest))
                on = np.abs(p[:, axis] - at - nearest) < ON_M
                measured.append(bool((on & (np.abs(p[:, 1 - axis] - middle) < PIECE_M)).any()))
    return WallOffsets(np.array(offsets), np.array(measured, dtype=np.bool_), pieces)


def _along_axis(wall: FloatArray) -> tuple[int, float, float, float]:
    """Of a wall (2, 2) the axis it stands across, where, and from where to where along the other one."""
    axis = int(np.argmin(np.abs(wall[1] - wall[0])))
    low, high = np.sort(wall[:, 1 - axis])
    return axis, float(wall[:, axis].mean()), float(low), float(high)


def _depth_alone(navigation: Navigation, truth: Truth) -> Navigation:
    """The scans from true poses, in the map's frame but in true metres; no landmark."""
    found = align_by_depth(navigation, truth)
    middle = truth.T_world_body[:, :3, 3].mean(axis=0)
    R = found.R_target_source.T
    t = transform(inverse_sim3(found.T_target_source), middle[None])[0] - R @ middle
    landmarks, keyframes = navigation.landmarks, navigation.keyframes
    return replace(
        navigation,
        trajectory=Trajectory(truth.t_robot_ns, se3(R, t) @ truth.T_world_body),
        keyframes=Keyframes(
            keyframes.frame_index[:0], keyframes.t_robot_ns[:0], keyframes.T_world_cam[:0], (), keyframes.segment[:0]
        ),
        landmarks=Landmarks(
            landmarks.p_world[:0],
            landmarks.rgb[:0],
            landmarks.cov_world[:0],
            landmarks.observed_landmark[:0],
            landmarks.observed_keyframe[:0],
            landmarks.observed_uv_px[:0],
        ),
    )
