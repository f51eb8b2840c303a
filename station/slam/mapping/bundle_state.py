"""What the bundle adjustment with odometry estimates, and from what."""

from __future__ import annotations

from dataclasses import dataclass

from shared.geometry import FloatArray, IntArray


@dataclass(frozen=True, slots=True, eq=False)
class BundleState:
    """What is estimated."""

    R_world_body: FloatArray  # (N, 3, 3)
    p_world_body: FloatArray  # (N, 3) m
    points: FloatArray  # (M, 3) m
    drive_scale: float  # real way per commanded way
    bias_change: FloatArray  # (3,) rad/s


@dataclass(frozen=True, slots=True, eq=False)
class Observations:
    """Sorted by keyframe, then point."""

    keyframe: IntArray  # (K,)
    point: IntArray  # (K,)
    xy: FloatArray  # (K, 2) normalised image coordinates
    T_cam_body: FloatArray  # (4, 4)
    focal_px: float
