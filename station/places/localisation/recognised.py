"""The landmarks that a hypothesis of where the robot is rests on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from shared.geometry import FloatArray, IntArray


@dataclass(frozen=True, slots=True, eq=False)
class Recognised:
    """Landmarks of one map that were recognised lately.

    A piece of furniture that looks like another one deceives every image of it, also when it comes into view bit by
    bit. So images do not count one by one: what counts is how large all is that they recognised together.
    """

    seen: Mapping[int, int]  # landmark -> robot time, ns, when it was recognised last

    def since(self, t_robot_ns: int) -> Recognised:
        """What was recognised after this time."""
        return Recognised({landmark: t for landmark, t in self.seen.items() if t > t_robot_ns})

    def and_then(self, landmarks: IntArray, t_robot_ns: int) -> Recognised:
        """With these (n,) too; images may come late."""
        return self | Recognised(dict.fromkeys(landmarks.tolist(), t_robot_ns))

    def __or__(self, other: Recognised) -> Recognised:
        both = {**self.seen, **other.seen}
        return Recognised({k: max(t, self.seen.get(k, t)) for k, t in both.items()})

    def share_of_new(self, landmarks: IntArray) -> float:
        """Of landmarks (n,), those that are not among these; of none all."""
        return sum(k not in self.seen for k in landmarks.tolist()) / len(landmarks) if len(landmarks) else 1.0

    def extent(self, p_map: FloatArray) -> float:
        """Median distance of the landmarks from their middle, in the units of their positions `p_map` (L, 3)."""
        return extent_of(p_map[np.fromiter(self.seen, np.int64, len(self.seen))]) if self.seen else 0.0


NOTHING = Recognised({})


def extent_of(p: FloatArray) -> float:
    """Median distance of points (n, 3) from their middle."""
    return float(np.median(np.linalg.norm(p - np.median(p, axis=0), axis=1)))
