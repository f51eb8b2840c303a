"""What part of space a map knows: where its drive went, and which views it could recognise."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from shared.geometry import FloatArray
from station.maps.map import PlaceMap

# A keyframe recognises views from about this near and this parallel (33 degrees of view, SIFT's limits).
VIEW_DISTANCE = 1.2
VIEW_ANGLE_RAD = np.radians(30.0)


class Coverage:
    """Keyframe poses of one map, searchable."""

    def __init__(self, place_map: PlaceMap, unit: float) -> None:
        """`unit`: map units per metre."""
        self._unit = unit
        poses = place_map.navigation.keyframes.T_world_cam
        self._position = poses[:, :3, 3]
        self._forward = poses[:, :3, 2]
        self._tree = cKDTree(self._position) if len(poses) else None

    def distance(self, p_map: FloatArray) -> FloatArray:
        """(n,) m from points (n, 3) to the nearest camera position of the mapping drive; inf without keyframes."""
        if self._tree is None:
            return np.full(len(p_map), np.inf)
        return np.asarray(self._tree.query(p_map)[0], dtype=np.float64) / self._unit

    def sees_known_view(self, T_map_cam: FloatArray) -> bool:
        """Whether a keyframe stands near this camera pose and looks the same way."""
        if self._tree is None:
            return False
        near = self._tree.query_ball_point(T_map_cam[:3, 3], VIEW_DISTANCE * self._unit)
        return bool(near) and bool(np.any(self._forward[near] @ T_map_cam[:3, 2] > np.cos(VIEW_ANGLE_RAD)))


def units_per_metre(place_map: PlaceMap) -> float:
    """Map units per metre; of an arbitrary scale a guess: a drive through a flat spans about five metres."""
    if place_map.navigation.is_metric:
        return 1.0
    positions = place_map.navigation.keyframes.T_world_cam[:, :3, 3]
    if len(positions) < 2:
        return 1.0
    return max(float(np.max(np.ptp(positions, axis=0))) / 5.0, 1e-6)
