"""The running SLAM as the page sees it: poses and landmarks that only grow, so that a reader fetches what is new."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from shared.geometry import FloatArray, IntArray, transform
from station.model.navigation import Navigation, Trajectory
from station.model.slam_update import SlamUpdate, TrackingState

MAX_LIVE_POINTS = 2_000_000
MAX_LIVE_POSES = 20_000  # the most that GET /trajectory gives


class PointBuffer:
    """Points that only get more; memory doubles when full."""

    def __init__(self) -> None:
        self._p: npt.NDArray[np.float32] = np.empty((1024, 3), np.float32)
        self._rgb: npt.NDArray[np.uint8] = np.empty((1024, 3), np.uint8)
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def add(self, p: npt.NDArray[np.floating], rgb: npt.NDArray[np.generic]) -> None:
        """(n, 3) positions and (n, 3) colours 0..255. Beyond the limit points are left out of the live view."""
        n = min(len(p), MAX_LIVE_POINTS - self._count)
        while self._count + n > len(self._p):
            self._p = np.concatenate([self._p, np.empty_like(self._p)])
            self._rgb = np.concatenate([self._rgb, np.empty_like(self._rgb)])
        self._p[self._count : self._count + n] = p[:n]
        self._rgb[self._count : self._count + n] = rgb[:n]
        self._count += n

    def since(self, first: int) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.uint8]]:
        """Copies of the points from number `first` on."""
        first = min(max(first, 0), self._count)
        return self._p[first : self._count].copy(), self._rgb[first : self._count].copy()


@dataclass(frozen=True, slots=True, eq=False)
class LivePose:
    t_robot_ns: int
    T_world_body: FloatArray  # (4, 4)
    segment: int


class LivePath:
    """The way so far, evenly thinned out: a drive of hours takes the memory of its first minutes.

    All poses are kept until there are MAX_LIVE_POSES; then every second one, then every fourth, and so on.
    """

    def __init__(self, max_poses: int = MAX_LIVE_POSES) -> None:
        self._t_robot_ns: IntArray = np.full(max_poses, 0)  # filled: what is only reserved would grow with its use
        self._T_world_body: FloatArray = np.full((max_poses, 4, 4), 0.0)
        self._count = 0
        self._step = 1  # of this many poses one is kept
        self.num_seen = 0
        self.newest: LivePose | None = None

    def add(self, pose: LivePose) -> None:
        if self.num_seen % self._step == 0:
            if self._count == len(self._t_robot_ns):
                self._thin_out()
            self._t_robot_ns[self._count] = pose.t_robot_ns
            self._T_world_body[self._count] = pose.T_world_body
            self._count += 1
        self.num_seen += 1
        self.newest = pose

    def trajectory(self) -> Trajectory:
        """The kept poses, and the newest one whether it is kept or not."""
        times, poses = self._t_robot_ns[: self._count], self._T_world_body[: self._count]
        if self.newest is None or times[-1] == self.newest.t_robot_ns:
            return Trajectory(times.copy(), poses.copy())
        return Trajectory(np.append(times, self.newest.t_robot_ns), np.concatenate([poses, [self.newest.T_world_body]]))

    def _thin_out(self) -> None:
        kept = slice(None, None, 2)
        self._count = len(self._t_robot_ns[kept])
        self._t_robot_ns[: self._count] = self._t_robot_ns[kept].copy()
        self._T_world_body[: self._count] = self._T_world_body[kept].copy()
        self._step *= 2


class LiveSlam:
    """What is known so far of one navigation."""

    def __init__(self, navigation_id: str) -> None:
        self.navigation_id = navigation_id
        self.source = navigation_id  # names this cloud: that of the finished navigation is another one
        self.state: TrackingState | None = None
        self.message = "waiting for the first picture"
        self.num_landmarks = 0
        self.frames = 0
        self.points = PointBuffer()
        self.path = LivePath()
        self.restarts = 0

    def restart(self) -> None:
        """SLAM begins anew: what comes is in another frame, so what came before is not shown with it."""
        self.restarts += 1
        self.source = f"{self.navigation_id}/part-{self.restarts + 1}"
        self.points = PointBuffer()
        self.path = LivePath()
        self.num_landmarks = 0

    @property
    def pose(self) -> LivePose | None:
        return self.path.newest

    def set_message(self, message: str) -> None:
        """How SLAM is, when no update can say it."""
        self.message = message

    def update(self, update: SlamUpdate) -> bool:
        """Take in what a frame changed; True when there are new points."""
        self.frames += 1
        self.state, self.message, self.num_landmarks = update.state, update.message, update.num_landmarks
        if (T := update.T_map_body) is not None:
            self.path.add(LivePose(update.t_robot_ns, T, update.segment))
        points, rgb = update.new_points_world, update.new_points_rgb
        if points is None or not len(points):
            return False
        if update.T_map_world is not None:
            points = transform(update.T_map_world, points)
        self.points.add(points, np.full((len(points), 3), 200, np.uint8) if rgb is None else rgb)
        return True

    @classmethod
    def of_finished(cls, navigation: Navigation, message: str) -> LiveSlam:
        live = cls(navigation.id)
        live.source = f"{navigation.id}/finished"
        live.state, live.message = None, message
        live.num_landmarks = len(navigation.landmarks)
        live.frames = navigation.report.frames
        live.points.add(navigation.landmarks.p_world, navigation.landmarks.rgb)
        times: IntArray = navigation.trajectory.t_robot_ns
        live.path = LivePath(max(1, len(times)))
        for t_ns, T in zip(times.tolist(), navigation.trajectory.T_world_body, strict=True):
            live.path.add(LivePose(t_ns, T, 0))
        return live
