"""Settings of matching and mapping, whoever made the features."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True, slots=True)
class MatchConfig:
    """Which keyframes are compared, and when two of them are believed to see the same."""

    num_previous: int = 6  # every keyframe against the ones just before it
    num_previous_with_odometry: int = 4
    num_shortlist: int = 4  # and against the older ones that look most alike
    shortlist_features: int = 200  # the largest features decide who looks alike
    min_shortlist_matches: int = 12
    max_ratio: float = 0.8  # Lowe's ratio, as in COLMAP
    min_inliers: int = 20
    max_error_px: float = 3.0
    min_gyro_inliers: int = 8  # of matches that agree with the gyroscope's rotation: chance gives 1 or 2
    loops_per_keyframe: int = 2
    min_loop_inliers: int = 15
    seed_of_pnp: int = 0


@dataclass(frozen=True, slots=True)
class MappingConfig:
    """From features to landmarks."""

    seed: int = 0
    matching: MatchConfig = field(default_factory=MatchConfig)
    min_track_length: int = 3
    min_triangulation_angle_deg: float = 1.5
