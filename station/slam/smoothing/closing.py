"""Loops closed while the robot drives (docs/slam.md, "Smoothing", 6): where the odometry's world lies in the map.

The odometry (filter and window of keyframes) drifts and never jumps. What is seen again says where it has drifted to:
T_map_odom. As REP-105 has it, who steers reads the odometry, who asks where the robot is reads T_map_odom with it.

The work of a view is done in steps, one a frame, so that no frame waits for all of it. Steps that only look may be
done before their frame, while no data wait: they go by the poses of the frame that chose the view, so that the same
data give the same result, whoever has had time meanwhile.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from shared.calibration import ImuNoise
from shared.geometry import FloatArray, inverse, se3, transform
from station.slam.mapping.config import MatchConfig
from station.slam.mapping.loops import MAX_ANGLE_RAD, MAX_DISTANCE_M, Seen, apart, landmarks_shown, recognise
from station.slam.mapping.odometry import MOTION_START, Drift
from station.slam.mapping.odometry_bundle import BundleState
from station.slam.mapping.odometry_mapping import GATE, LAST_SCALES, gather, triangulate_and_prune, verify_by_gyro
from station.slam.mapping.pose_graph import LoopEdge, locate, solve_pose_graph
from station.slam.mapping.shortlist import Shortlist
from station.slam.mapping.tracks import build_tracks
from station.slam.ukf.map.view_map import DRIFT, relative_motions, straight_rays
from station.slam.ukf.map.views import MapViews, View
from station.vision.camera_model import CameraModel
from station.vision.triangulation import triangulate

PoseOf = Callable[[int], FloatArray | None]  # (4, 4) T_odom_body of a frame, by its index
AROUND = 4  # views before and after an old one, from which its landmarks are triangulated
MAX_DEPTH_SIGMA = 0.1  # relative; landmarks known worse say little of a position
MIN_AGO_S = 10.0  # what was seen a moment ago is found again by its patches (recall.py)
RECENT = 12  # views within which another one must say the same of the drift
AGREE = Drift(position_m=0.05, position_per_way=0.02, rotation_rad=0.02)  # two loops, with the way between them
SIGMA_RAD, SIGMA_M = 0.002, 0.005  # of a loop, besides what its landmarks leave open


@dataclass(frozen=True, slots=True, eq=False)
class Claim:
    """That a view shows what an older one showed."""

    old: int  # frame index
    new: int
    T_old_new: FloatArray  # (4, 4) of the body
    cov: FloatArray  # (6, 6), see LoopEdge


class LoopCloser:
    """Looks for what each new view of a piece of tracking shows again; see `look`."""

    def __init__(
        self,
        views: MapViews,
        segment: int,
        T_odom: PoseOf,
        camera: CameraModel,
        noise: ImuNoise,
        T_map_odom: FloatArray,
    ) -> None:
        """Args:
        T_odom: poses by the odometry as it has them when asked.
        T_map_odom: (4, 4) as known when this piece of tracking begins.
        """
        self._views, self._segment, self._T_odom = views, segment, T_odom
        self._camera, self._noise = camera, noise
        self._config: MatchConfig = views.mapping.matching
        self._T_body_cam = se3(camera.R_body_cam, camera.t_body_cam)
        self._focal_px = camera.lens.camera.fx
        self._shortlist = Shortlist(self._config)
        self._listed: list[int] = []  # frame indices
        self._newest = -1  # frame index of the newest view that was looked at
        self._work: Iterator[bool] = iter(())  # steps; each says whether the next one may be done before its frame
        self._may_go_on = False
        self._num_ahead = 0  # steps done before their frame
        self._spacing = views.spacing
        self._claims: list[Claim] = []  # of the newest views
        self._T_map: dict[int, FloatArray] = {}  # by frame index, as the graph has them
        self.closed: dict[tuple[int, int], Claim] = {}  # by the frame indices of both
        self.T_map_odom = T_map_odom

    def look(self) -> None:
        """Do the next step of what the views ask for, called once a frame; and one more for each view that waits."""
        if self._views.spacing != self._spacing:  # they were thinned out, and what was looked at may be gone
            self._work, self._num_ahead, self._spacing = iter(()), 0, self._views.spacing
        for _ in range(1 + len(self._views.chosen_after(self._newest))):
            if self._num_ahead:
                self._num_ahead -= 1
            elif not self._step():
                waiting = self._views.chosen_after(self._newest)
                if not waiting:
                    return
                self._newest = waiting[0]
                self._work = self._look_back(self._newest, self._poses_until(self._newest))
                self._may_go_on = True

    def look_ahead(self) -> bool:
        """Do a step before its frame; False where the next one has to wait for that."""
        if not self._may_go_on or not self._step():
            return False
        self._num_ahead += 1
        return True

    def _step(self) -> bool:
        """Do the next step of the view that is being looked at; False where there is none."""
        may_go_on = next(self._work, None)
        self._may_go_on = bool(may_go_on)
        return may_go_on is not None

    # ---- the steps of one view

    def _look_back(self, frame: int, T_then: dict[int, FloatArray]) -> Iterator[bool]:
        """Describe the view, see what it could show again, look at each of those, correct the map.

        Args: T_then: poses of the views by the odometry, when it was chosen.
        """
        self._views.describe_until(frame)
        yield True
        views, T_odom = self._known(T_then)
        if not views or views[-1].frame_index != frame:
            return
        self._list(views)
        ways = self._ways(T_odom, {v.frame_index: k for k, v in enumerate(views)})
        alike = self._shortlist.most_alike(views[-1].features, self._within_reach(views, T_odom, ways))
        alike = alike[: self._config.loops_per_keyframe]
        yield bool(alike)
        claims = []
        for k, a in enumerate(alike):
            claim = self._compare(views, T_odom, a, float(ways[a]))
            claims += [] if claim is None else [claim]
            yield k < len(alike) - 1
        if claims:
            self._claims += claims
            self._close(*self._known(self._poses_until(frame)))

    def _poses_until(self, frame: int) -> dict[int, FloatArray]:
        """(4, 4) of the views up to one, as the odometry has them now; by frame index."""
        frames = (f for f in self._views.chosen_after(-1) if f <= frame)
        return {f: T for f in frames if (T := self._T_odom(f)) is not None}

    def _known(self, T_odom: dict[int, FloatArray]) -> tuple[list[View], FloatArray]:
        """This segment's views that have a pose, and those (N, 4, 4)."""
        views = [v for v in self._views.described() if v.segment == self._segment and v.frame_index in T_odom]
        return views, np.array([T_odom[v.frame_index] for v in views]).reshape(-1, 4, 4)

    def _list(self, views: list[View]) -> None:
        frames = [v.frame_index for v in views]
        if frames[: len(self._listed)] != self._listed:  # the views were thinned out
            self._shortlist, self._listed = Shortlist(self._config), []
        for v in views[len(self._listed) :]:
            self._shortlist.add(v.features)
        self._listed = frames

    def _in_map(self, views: list[View], T_odom: FloatArray) -> FloatArray:
        """(N, 4, 4) poses in the map: by the graph, those after it by the odometry since."""
        later = self.T_map_odom @ T_odom
        return np.array([self._T_map.get(v.frame_index, T) for v, T in zip(views, later, strict=True)])

    def _ways(self, T_odom: FloatArray, at: dict[int, int]) -> FloatArray:
        """(N,) m, over which the odometry may have drifted between each view and the newest: the shortest way along it
        and through loops."""
        n = len(T_odom)
        loops = np.array([(at[c.old], at[c.new]) for c in self._still_there(at)], dtype=np.int64).reshape(-1, 2)
        ends = np.vstack([np.column_stack([np.arange(n - 1), np.arange(1, n)]), loops])
        steps = np.linalg.norm(np.diff(T_odom[:, :3, 3], axis=0), axis=1)
        length = np.concatenate([steps, np.zeros(len(loops))]) + 1e-6  # what has no length is no edge to SciPy
        graph = coo_array((length, (ends[:, 0], ends[:, 1])), shape=(n, n))
        return np.asarray(dijkstra(graph, directed=False, indices=n - 1))

    def _within_reach(self, views: list[View], T_odom: FloatArray, ways: FloatArray) -> list[int]:
        """Views of some time ago that this one may see the same as, wherever the odometry has drifted to."""
        T_cam = self._in_map(views, T_odom) @ self._T_body_cam
        angle = np.arccos(np.clip(T_cam[:, :3, 2] @ T_cam[-1, :3, 2], -1.0, 1.0))
        distance = np.linalg.norm(T_cam[:, :3, 3] - T_cam[-1, :3, 3], axis=1)
        drifted_m = DRIFT.position_m + DRIFT.position_per_way * ways
        near = (angle < MAX_ANGLE_RAD + DRIFT.rotation_rad) & (distance < MAX_DISTANCE_M + drifted_m)
        t_s = np.array([v.keyframe.image.t_robot_ns for v in views]) * 1e-9
        return [int(k) for k in np.flatnonzero(near & (t_s[-1] - t_s > MIN_AGO_S))]

    def _compare(self, views: list[View], T_odom: FloatArray, a: int, way_m: float) -> Claim | None:
        """That the newest view shows what view number `a` showed, on a way over which the odometry drifted; or None."""
        new, T_map = views[-1], self._in_map(views, T_odom)
        old, cov = self._seen_by(views, T_odom, a, T_map[a] @ inverse(T_odom[a]))
        rays = straight_rays(new, self._camera)
        found = recognise(
            old, new.features, rays, T_map[-1] @ self._T_body_cam,
            way_m, self._focal_px, DRIFT, self._config,
        )  # fmt: skip
        if found is None:
            return None
        located = locate(
            found.T_world_cam @ inverse(self._T_body_cam), old.points[found.landmark], cov[found.landmark],
            rays[found.pairs[:, 1]], self._camera.sigma_px / self._focal_px, self._T_body_cam,
        )  # fmt: skip
        if located is None:
            return None
        T_map_body, cov_pose = located
        cov_pose = cov_pose + np.diag(np.repeat([SIGMA_RAD**2, SIGMA_M**2], 3))
        return Claim(views[a].frame_index, new.frame_index, inverse(T_map[a]) @ T_map_body, cov_pose)

    def _seen_by(
        self, views: list[View], T_odom: FloatArray, a: int, T_map_odom: FloatArray
    ) -> tuple[Seen, FloatArray]:
        """What a view's features show, triangulated from it and its neighbours; covariances (M, 3, 3)."""
        first, last = max(0, a - AROUND), min(len(views), a + AROUND + 1)
        some = views[first:last]
        rays = [straight_rays(v, self._camera) for v in some]
        T = T_odom[first:last]
        state = BundleState(T[:, :3, :3], T[:, :3, 3], np.empty((0, 3)), MOTION_START)
        rng = np.random.default_rng(self._views.mapping.seed)
        threshold = self._config.max_error_px / self._focal_px
        matches = self._views.matches_among([v.frame_index for v in some])
        matches = verify_by_gyro(matches, rays, T[:, :3, :3] @ self._T_body_cam[:3, :3], threshold, rng)
        counts = [len(v.features) for v in some]
        tracks = build_tracks(counts, [m for m in matches if len(m[2]) >= self._config.min_gyro_inliers])
        tracks, _ = triangulate_and_prune(state, tracks, rays, self._camera.lens.camera, GATE * LAST_SCALES[-1])
        xy, seen = np.zeros((tracks.num_points, len(some), 2)), np.zeros((tracks.num_points, len(some)), dtype=bool)
        xy[tracks.point, tracks.keyframe] = gather(tracks, rays)
        seen[tracks.point, tracks.keyframe] = True
        R, x = (np.broadcast_to(part, (tracks.num_points, *part.shape)) for part in (T[:, :3, :3], T[:, :3, 3]))
        points = triangulate(self._camera, R, x, xy, seen)
        known = np.append(points.is_good & (points.depth_sigma < MAX_DEPTH_SIGMA), False)
        shown = landmarks_shown(tracks, counts)[a - first]
        R, p_map = T_map_odom[:3, :3], transform(T_map_odom, points.p)
        return Seen(some[a - first].features, np.where(known[shown], shown, -1), p_map), R @ points.cov @ R.T

    # ---- the map

    def _close(self, views: list[View], T_odom: FloatArray) -> None:
        """Believe what two views say alike, and let everything follow."""
        at = {v.frame_index: k for k, v in enumerate(views)}
        T_map = self._in_map(views, T_odom)
        oldest = views[max(0, len(views) - RECENT)].frame_index
        self._claims = [c for c in self._claims if c.new >= oldest and c.old in at and c.new in at]
        believed = [c for c in self._claims if any(self._agree(c, d, at, T_map, T_odom) for d in self._claims)]
        if not any(c.new == views[-1].frame_index for c in believed):
            return
        self.closed = {(c.old, c.new): c for c in (*self._still_there(at), *believed)}
        motions = relative_motions(with_poses(views, T_odom), self._noise)
        edges = [LoopEdge(at[c.old], at[c.new], c.T_old_new, c.cov) for c in self.closed.values()]
        T_map = solve_pose_graph(motions, edges, T_map)
        self._T_map = {v.frame_index: T for v, T in zip(views, T_map, strict=True)}
        self.T_map_odom = T_map[-1] @ inverse(T_odom[-1])

    def _agree(self, c: Claim, d: Claim, at: dict[int, int], T_map: FloatArray, T_odom: FloatArray) -> bool:
        """Whether two views say the same of the drift."""
        if c.new == d.new:
            return False
        i, j = at[c.new], at[d.new]
        by_c = T_map[at[c.old]] @ c.T_old_new
        by_d = T_map[at[d.old]] @ d.T_old_new @ inverse(T_odom[j]) @ T_odom[i]
        return AGREE.explains(*apart(by_c, by_d), way_of(T_odom[min(i, j) : max(i, j) + 1]))

    def _still_there(self, at: dict[int, int]) -> Iterator[Claim]:
        """The loops so far; those of views that were left out meanwhile hang on the views before these."""
        frames = sorted(at)
        for c in self.closed.values():
            ends = [frames[max(0, bisect_right(frames, frame) - 1)] for frame in (c.old, c.new)]
            old, new, T_old, T_new = (self._T_odom(frame) for frame in (*ends, c.old, c.new))
            if ends == [c.old, c.new] or old is None or new is None or T_old is None or T_new is None:
                yield c
            else:
                yield Claim(ends[0], ends[1], inverse(old) @ T_old @ c.T_old_new @ inverse(T_new) @ new, c.cov)


def way_of(T: FloatArray) -> float:
    """m, along poses (N, 4, 4)."""
    return float(np.linalg.norm(np.diff(T[:, :3, 3], axis=0), axis=1).sum())


def with_poses(views: list[View], T: FloatArray) -> list[View]:
    return [replace(v, keyframe=replace(v.keyframe, T_world_head=pose)) for v, pose in zip(views, T, strict=True)]
