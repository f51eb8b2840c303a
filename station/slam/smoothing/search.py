"""Which lost landmarks to look for in a keyframe, and which of the finds to believe."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shared.geometry import FloatArray, IntArray
from station.model.frames import ImageArray
from station.slam.smoothing.config import RecallConfig
from station.slam.smoothing.keyframe import camera_pose
from station.slam.smoothing.landmarks import LandmarkTable
from station.slam.smoothing.recall import are_in_view, find_again, predict_views
from station.vision.camera_model import CameraModel
from station.vision.camera_pose import solve_pose_from
from station.vision.klt import TrackedFrame

SAME_PX = 2.0  # a find nearer than this to a track is that track
NEAR_PX = 8.0  # nearer than this, but not the same: one of the two is wrong
PAIR = tuple[int, int]


@dataclass(frozen=True, slots=True, eq=False)
class Recalled:
    landmarks: IntArray  # (n,) numbers of those found where nothing was followed
    uv_px: FloatArray  # (n, 2)
    same: list[PAIR]  # a track, and the landmark that it shows
    trusted: IntArray  # of all found, those that agree on one pose


class Recaller:
    def __init__(self, camera: CameraModel, config: RecallConfig) -> None:
        self._camera, self._config = camera, config

    def search(
        self, table: LandmarkTable, image: ImageArray, tracked: TrackedFrame, T_world_body: FloatArray, oldest: int
    ) -> Recalled:
        """Look for landmarks that are not followed now.

        Args:
            T_world_body: predicted pose of the image.
            oldest: keyframe with which the window begins.
        """
        camera, config = self._camera, self._config
        T_world_cam = camera_pose(T_world_body, camera)
        shown = table.named(tracked)
        lost = table.lost(shown.ids)
        nothing = Recalled(np.zeros(0, dtype=np.int64), np.zeros((0, 2)), [], np.zeros(0, dtype=np.int64))
        lost = lost[are_in_view(camera.lens, T_world_cam, table.p_world[lost], table.seen_from(lost), config)]
        if not len(lost):
            return nothing
        _, _, is_visible = predict_views(camera.lens, T_world_cam, table.p_world[lost], table.patches(lost), config)
        rows = self._candidates(table, lost[is_visible])
        if not len(rows):
            return nothing
        is_old = table.last_seen[rows] < oldest
        reach = np.where(is_old, config.old_reach_px, config.reach_px)
        found = find_again(image, camera.lens, T_world_cam, table.p_world[rows], table.patches(rows), reach, config)
        rows, uv, is_old = rows[found.rows], found.uv_px, is_old[found.rows]
        agree = self._agreeing(table.p_world[rows], uv, T_world_cam)
        good = agree | ~is_old
        return self._sorted_out(table, tracked, rows[good], uv[good], agree[good])

    def _candidates(self, table: LandmarkTable, rows: IntArray) -> IntArray:
        """Half of them those seen last, half those seen first: these tell of drift."""
        most = self._config.max_candidates
        if len(rows) <= most:
            return rows
        order = rows[np.argsort(-table.last_seen[rows], kind="stable")]
        recent = order[: most // 2]
        first = np.setdiff1d(rows, recent)[: most - len(recent)]
        return np.sort(np.concatenate([recent, first]))

    def _agreeing(
        self, p_world: FloatArray, uv: FloatArray, T_world_cam: FloatArray
    ) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
        """Which finds one pose explains; none where too few do."""
        config, camera = self._config, self._camera
        none = np.zeros(len(uv), dtype=bool)
        if len(uv) < config.min_agreeing:
            return none
        tolerance = config.agree_px / camera.lens.camera.fx
        for wide in (4.0, 1.0):
            pose = solve_pose_from(T_world_cam, p_world, camera.lens.unproject(uv), wide * tolerance)
            if pose is None:
                return none
            T_world_cam = pose.T_map_cam
        agree = pose.inlier if pose is not None else none
        return agree if int(agree.sum()) >= max(config.min_agreeing, len(uv) // 2) else none

    def _sorted_out(
        self,
        table: LandmarkTable,
        tracked: TrackedFrame,
        rows: IntArray,
        uv: FloatArray,
        agree: np.ndarray[tuple[int, ...], np.dtype[np.bool_]],
    ) -> Recalled:
        """New tracks where nothing was followed; where something is, it is the landmark or contradicts it."""
        numbers = table.number[rows]
        trusted = numbers[agree]
        if not len(tracked.ids):
            return Recalled(numbers, uv, [], trusted)
        distance = np.linalg.norm(uv[:, None] - tracked.uv_px[None], axis=2)
        nearest, at = distance.min(axis=1), distance.argmin(axis=1)
        free = nearest > NEAR_PX
        same = [(int(tracked.ids[at[i]]), int(numbers[i])) for i in np.flatnonzero(nearest < SAME_PX).tolist()]
        # Two finds at one place: the first stays.
        keep = np.flatnonzero(free)
        apart = np.linalg.norm(uv[keep][:, None] - uv[keep][None], axis=2)
        clash = np.triu(apart < NEAR_PX, 1).any(axis=0)
        keep = keep[~clash]
        return Recalled(numbers[keep], uv[keep], same, trusted)
