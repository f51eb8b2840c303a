"""Which views were looked at lately: one that is looked at again says nothing new of where the robot is."""

from __future__ import annotations

import numpy as np

from shared.geometry import FloatArray
from station.places.making.scale import USUAL_VIEWING_M


class RecentViews:
    """Of one camera, in odometry's frame. A robot that turns its head, or itself, to and fro sees the same again."""

    def __init__(self, memory_s: float) -> None:
        self._memory_ns = round(memory_s * 1e9)
        self._views: list[tuple[int, FloatArray]] = []  # robot time and T_nav_head of each
        self._is_last_failed = True

    def add(self, t_robot_ns: int, T_nav_head: FloatArray, *, is_failed: bool) -> None:
        """Where the head was when an image was taken, and whether that was not recognised.

        A recognised one is forgotten with the next image: where it was recognised before, failing is news.
        """
        views = self._lately(t_robot_ns)
        if views and not self._is_last_failed:
            views = views[:-1]
        self._views, self._is_last_failed = [*views, (t_robot_ns, T_nav_head)], is_failed

    def clear(self) -> None:
        """Odometry's frame is another one, or the robot elsewhere."""
        self._views = []

    def change(self, t_robot_ns: int, T_nav_head: FloatArray) -> float:
        """By how much this view differs from the most similar of them, rad; infinite without any."""
        lately = self._lately(t_robot_ns)
        if not lately:
            return np.inf
        T = np.stack([T for _, T in lately])
        distance = np.linalg.norm(T[:, :3, 3] - T_nav_head[:3, 3], axis=1)
        cosine = 0.5 * (np.einsum("nij,ij->n", T[:, :3, :3], T_nav_head[:3, :3]) - 1.0)
        return float((distance / USUAL_VIEWING_M + np.arccos(np.clip(cosine, -1.0, 1.0))).min())

    def _lately(self, t_robot_ns: int) -> list[tuple[int, FloatArray]]:
        forgotten = t_robot_ns - self._memory_ns
        return [view for view in self._views if view[0] > forgotten]
