"""The running SLAM as the page sees it: poses and landmarks that only grow, so that a reader fetches what is new."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from shared.geometry import FloatArray, IntArray, transform
from station.model.navigation import Navigation, Trajectory
from station.model.slam_update import SlamUpdate, TrackingState

MAX_LIVE_POINTS = 100_000  # of a running navigation: 3.1 MB
MAX_FINISHED_POINTS = 2_000_000
# Finer than anybody sees: of a flat of 10 m that fills the page a pixel is 1 cm and a point two pixels wide, and the
# page's line of the way has steps of 2 cm. Where the scale is arbitrary it is so many units.
LIVE_CELL_M = 0.02
MAX_LIVE_POSES = 20_000  # the most that GET /trajectory gives
# Points or poses, when some are left out: of all of them at once, the allocator would keep 2 MB of temporary arrays.
AT_A_TIME = 4096
_CELLS_ASIDE = 2**20  # of a cell's three numbers: they share one of 63 bits. That is 20 km


class PointBuffer:
    """Points that only get more, at most one in each cell of space: a room that is known already adds hardly any.

    When full, cells become wider until at most half of the points are left, and those are numbered anew. So a drive of
    hours takes the memory of its first minute, however its landmarks scatter.
    """

    def __init__(self, max_points: int = MAX_LIVE_POINTS, cell: float = LIVE_CELL_M) -> None:
        # Filled: what is only reserved would grow with its use.
        self._p: npt.NDArray[np.float32] = np.full((max_points, 3), 0.0, np.float32)
        self._rgb: npt.NDArray[np.uint8] = np.full((max_points, 3), 0, np.uint8)
        # Of all points, ascending. More are merged into the other array: temporary ones would grow with the number.
        self._cells: IntArray = np.full(max_points, 0)
        self._other_cells: IntArray = np.full(max_points, 0)
        self._cell = cell
        self._count = 0
        self.renumbered = 0  # how often points were left out that had numbers

    @classmethod
    def holding(cls, p: npt.NDArray[np.floating], rgb: npt.NDArray[np.uint8]) -> PointBuffer:
        """All these points, however close together, and no more: (n, 3) positions and (n, 3) colours 0..255."""
        buffer = cls(0)
        buffer._p, buffer._rgb = p[:MAX_FINISHED_POINTS].astype(np.float32), rgb[:MAX_FINISHED_POINTS].copy()
        buffer._count = len(buffer._p)
        return buffer

    def __len__(self) -> int:
        return self._count

    def add(self, p: npt.NDArray[np.floating], rgb: npt.NDArray[np.generic]) -> int:
        """(n, 3) positions and (n, 3) colours 0..255, the first of each cell stays. Returns how many were new."""
        is_somewhere = np.isfinite(p).all(axis=1)
        p, rgb = p[is_somewhere].astype(np.float32), rgb[is_somewhere]
        new, cells = self._new(p)
        while self._count + len(new) > len(self._p):
            self._thin_out()
            new, cells = self._new(p)
        self._put(p, rgb, new, cells)
        return len(new)

    def _put(self, p: npt.NDArray[np.float32], rgb: npt.NDArray[np.generic], new: IntArray, cells: IntArray) -> None:
        """Behind the others, what `_new` says of these points."""
        end = self._count + len(new)
        self._p[self._count : end], self._rgb[self._count : end] = p[new], rgb[new]
        self._merge(cells)
        self._count = end

    def _merge(self, cells: IntArray) -> None:
        """Among the cells of all points, these, ascending."""
        known, end = self._cells[: self._count], self._count + len(cells)
        is_known = np.full(end, fill_value=True)
        is_known[np.searchsorted(known, cells) + np.arange(len(cells))] = False
        self._other_cells[:end][is_known] = known
        self._other_cells[:end][~is_known] = cells
        self._cells, self._other_cells = self._other_cells, self._cells

    def since(self, first: int) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.uint8]]:
        """Copies of the points from number `first` on."""
        first = min(max(first, 0), self._count)
        return self._p[first : self._count].copy(), self._rgb[first : self._count].copy()

    def _cells_of(self, p: npt.NDArray[np.float32]) -> IntArray:
        """(n,) one number for each cell."""
        x, y, z = np.rint(p.astype(np.float64) / self._cell).clip(-_CELLS_ASIDE, _CELLS_ASIDE - 1).astype(np.int64).T
        cells: IntArray = ((x + _CELLS_ASIDE) << 42) | ((y + _CELLS_ASIDE) << 21) | (z + _CELLS_ASIDE)
        return cells

    def _new(self, p: npt.NDArray[np.float32]) -> tuple[IntArray, IntArray]:
        """Which of these points are the first in their cells, in their order; these cells, ascending."""
        cells, first = np.unique(self._cells_of(p), return_index=True)
        known = self._cells[: self._count]
        at = np.searchsorted(known, cells)
        is_new = at == len(known)
        is_new[~is_new] = known[at[~is_new]] != cells[~is_new]
        return np.sort(first[is_new]), cells[is_new]

    def _thin_out(self) -> None:
        self.renumbered += 1
        self._widen()
        while self._count > max(1, len(self._p) // 2):
            self._widen()

    def _widen(self) -> None:
        """Twice as wide cells; the points are put in anew, in place."""
        self._cell *= 2.0
        count, self._count = self._count, 0
        for begin in range(0, count, AT_A_TIME):
            part = slice(begin, min(begin + AT_A_TIME, count))
            p, rgb = self._p[part].copy(), self._rgb[part].copy()
            self._put(p, rgb, *self._new(p))


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
        self._count = (len(self._t_robot_ns) + 1) // 2
        for begin in range(0, self._count, AT_A_TIME // 2):
            end = min(begin + AT_A_TIME // 2, self._count)
            kept = slice(2 * begin, 2 * end, 2)
            self._t_robot_ns[begin:end] = self._t_robot_ns[kept].copy()
            self._T_world_body[begin:end] = self._T_world_body[kept].copy()
        self._step *= 2


class LiveSlam:
    """What is known so far of one navigation."""

    def __init__(self, navigation_id: str) -> None:
        self.navigation_id = navigation_id
        self.source = navigation_id  # names this cloud: that of the finished navigation is another one
        self.restarts = 0
        self._parts = 1  # clouds so far
        self.state: TrackingState | None = None
        self.message = "waiting for the first picture"
        self.num_landmarks = 0
        self.frames = 0
        self.points = PointBuffer()
        self.path = LivePath()

    def restart(self) -> None:
        """SLAM begins anew: what comes is in another frame, so what came before is not shown with it."""
        self.restarts += 1
        self._begin_cloud()
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
        """Take in what a frame changed; True when there are new points, or old ones have other numbers."""
        self.frames += 1
        self.state, self.message, self.num_landmarks = update.state, update.message, update.num_landmarks
        if (T := update.T_map_body) is not None:
            self.path.add(LivePose(update.t_robot_ns, T, update.segment))
        points, rgb = update.new_points_world, update.new_points_rgb
        if points is None or not len(points):
            return False
        if update.T_map_world is not None:
            points = transform(update.T_map_world, points)
        renumbered = self.points.renumbered
        num_new = self.points.add(points, np.full((len(points), 3), 200, np.uint8) if rgb is None else rgb)
        if self.points.renumbered == renumbered:
            return num_new > 0
        self._begin_cloud()  # whoever has the points up to some number has others
        return True

    def _begin_cloud(self) -> None:
        """Readers fetch all of it."""
        self._parts += 1
        self.source = f"{self.navigation_id}/part-{self._parts}"

    @classmethod
    def of_finished(cls, navigation: Navigation, message: str) -> LiveSlam:
        live = cls(navigation.id)
        live.source = f"{navigation.id}/finished"
        live.state, live.message = None, message
        live.num_landmarks = len(navigation.landmarks)
        live.frames = navigation.report.frames
        live.points = PointBuffer.holding(navigation.landmarks.p_world, navigation.landmarks.rgb)
        times: IntArray = navigation.trajectory.t_robot_ns
        live.path = LivePath(max(1, len(times)))
        for t_ns, T in zip(times.tolist(), navigation.trajectory.T_world_body, strict=True):
            live.path.add(LivePose(t_ns, T, 0))
        return live
