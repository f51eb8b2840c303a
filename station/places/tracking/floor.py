"""The floor that a map's robot drove on: a robot on wheels stands on it, upright, wherever an image says it is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from shared.geometry import FloatArray
from station.model.navigation import Navigation


@dataclass(frozen=True, slots=True, eq=False)
class Floor:
    """Where the mapping robot's body was at its keyframes."""

    p_map: FloatArray  # (F, 3)
    tree: cKDTree  # of x and y

    @classmethod
    def of(cls, navigation: Navigation) -> Floor | None:
        """None where the map's robot was carried, where nobody knows which way is up, or without keyframes."""
        camera, T_map_cam = navigation.calibration.camera, navigation.keyframes.T_world_cam
        is_level = navigation.calibration.has_wheels and navigation.report.gravity_aligned
        if camera is None or not is_level or not len(T_map_cam):
            return None
        p_map = (T_map_cam @ camera.T_cam_body_matrix)[:, :3, 3]
        return cls(p_map, cKDTree(p_map[:, :2]))

    def off(self, T_map_body: FloatArray, sigma: float, sigma_rad: float) -> float:
        """How far a pose (4, 4) is from standing on the floor: squared Mahalanobis distance of height and tilt.

        Args:
            sigma: of its height, in the map's units.
        """
        _, nearest = self.tree.query(T_map_body[:2, 3])
        height = T_map_body[2, 3] - self.p_map[nearest, 2]
        tilt = np.arccos(np.clip(T_map_body[2, 2], -1.0, 1.0))
        return float((height / sigma) ** 2 + (tilt / sigma_rad) ** 2)
