"""Points that were seen, and where each was seen from: landmarks from keyframes, and what a depth sensor measured.

Whoever asks where space is free or taken asks this, so that depth counts as landmarks do. Depth pictures are dense
where landmarks are few: their points are gathered into cubes as wide as a plan's cells, each of which counts once.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from shared.geometry import FloatArray, IntArray, rotation_angle, transform
from station.model.navigation import Navigation
from station.motion.interpolation import scan_poses

CUBE_M = 0.05
# A scan counts when the sensor has moved or turned so far since the last one that did: one from the same place shows
# the same again, and thousands of them would outvote everything else.
MOVED_M, TURNED_RAD = 0.1, np.radians(5.0)


@dataclass(frozen=True, slots=True, eq=False)
class Observed:
    """Row k of (K,) is an observation: which point, and from which eye."""

    p_map: FloatArray  # (M, 3) map units
    eye_map: FloatArray  # (E, 3) map units
    point: IntArray  # (K,) index into p_map
    eye: IntArray  # (K,) index into eye_map

    @classmethod
    def of(cls, navigation: Navigation) -> Observed:
        """Of a map without metres, landmarks alone: nobody knows how far its depth reaches."""
        landmarks = navigation.landmarks
        eyes = navigation.keyframes.T_world_cam[:, :3, 3]
        seen = cls(landmarks.p_world, eyes, landmarks.observed_landmark, landmarks.observed_keyframe)
        return seen if navigation.depth is None or not navigation.is_metric else seen._with(_scanned(navigation))

    @property
    def num_observations(self) -> IntArray:
        """(M,) from how many eyes each point was seen."""
        return np.bincount(self.point, minlength=len(self.p_map)).astype(np.int64)

    def by_eye(self) -> list[IntArray]:
        """For each eye the rows of its observations, in the order in which they are stored."""
        order = np.argsort(self.eye, kind="stable")
        begin = np.searchsorted(self.eye[order], np.arange(len(self.eye_map) + 1))
        return [order[a:b] for a, b in itertools.pairwise(begin)]

    def _with(self, other: Observed) -> Observed:
        return Observed(
            np.concatenate([self.p_map, other.p_map]),
            np.concatenate([self.eye_map, other.eye_map]),
            np.concatenate([self.point, other.point + len(self.p_map)]),
            np.concatenate([self.eye, other.eye + len(self.eye_map)]),
        )


def _scanned(navigation: Navigation) -> Observed:
    depth = navigation.depth
    assert depth is not None
    T_world_body, kept = scan_poses(navigation.trajectory, depth)
    chosen = _apart(T_world_body)
    T_body_depth = depth.sensor.T_body_depth_matrix
    eyes = (T_world_body[chosen] @ T_body_depth)[:, :3, 3].reshape(-1, 3)
    scans = [transform(T_world_body[i], depth.points_body(int(kept[i]))) for i in chosen]
    p = np.concatenate([np.empty((0, 3)), *scans])
    scan = np.repeat(np.arange(len(scans)), [len(s) for s in scans])
    cube, count = _numbered(np.floor(p / CUBE_M).astype(np.int64))
    size = np.bincount(cube, minlength=count)
    middle = np.stack([np.bincount(cube, p[:, axis], count) / size for axis in range(3)], axis=1)
    pairs = np.unique(scan * count + cube)
    return Observed(middle, eyes, pairs % max(count, 1), pairs // max(count, 1))


def _numbered(cells: IntArray) -> tuple[IntArray, int]:
    """For each cell (n, 3) its number among the different ones, and how many these are."""
    number = np.zeros(len(cells), dtype=np.int64)
    for column in cells.T:  # one axis after the other: products of three extents may be more than an integer holds
        _, at = np.unique(column, return_inverse=True)
        _, number = np.unique(number * (at.max(initial=0) + 1) + at, return_inverse=True)
    return number.astype(np.int64), int(number.max(initial=-1)) + 1


def _apart(T: FloatArray) -> list[int]:
    """Indices of poses (n, 4, 4), each moved or turned against the chosen one before it."""
    chosen: list[int] = []
    for i, pose in enumerate(T):
        if chosen:
            last = T[chosen[-1]]
            moved = float(np.linalg.norm(pose[:3, 3] - last[:3, 3]))
            if moved < MOVED_M and float(rotation_angle(last[:3, :3].T @ pose[:3, :3])) < TURNED_RAD:
                continue
        chosen.append(i)
    return chosen
