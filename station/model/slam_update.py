"""What SLAM says of each frame, to the live view and to the recording."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from shared.geometry import FloatArray
from station.model.calibration_fit import CalibrationFit

TrackingState = Literal["initialising", "tracking", "lost"]


@dataclass(frozen=True, slots=True, eq=False)
class SlamUpdate:
    """What one frame changed."""

    t_robot_ns: int
    state: TrackingState
    message: str  # for a person: "not initialised yet: needs ..."
    T_world_body: (
        FloatArray | None
    )  # (4, 4); None while there is no pose (an offline backend never has one before finish)
    num_landmarks: int
    is_keyframe: bool
    new_points_world: FloatArray | None = None  # (n, 3) landmarks finished since the last update, for the live view
    new_points_rgb: FloatArray | None = None  # (n, 3) 0..255
    segment: int = 0
    scale: Literal["metric", "arbitrary"] = "metric"  # of poses and points
    calibration_fit: CalibrationFit | None = None  # what the drive so far says of it
    # (4, 4) where the world of poses and points, which drifts and never jumps, lies in the map of what was seen again
    # (world is REP-105's odom). None: nobody looks for that, or there is no map yet.
    T_map_world: FloatArray | None = None

    @property
    def T_map_body(self) -> FloatArray | None:
        """(4, 4) by all that was seen again: it jumps when a loop closes, so nobody steers by it."""
        if self.T_map_world is None or self.T_world_body is None:
            return self.T_world_body
        return self.T_map_world @ self.T_world_body
