"""Settings of the structure-from-motion backend."""

from __future__ import annotations

from dataclasses import dataclass, field

from station.slam.mapping.config import MappingConfig, MatchConfig


@dataclass(frozen=True, slots=True)
class KeyframeConfig:
    """When a frame becomes a keyframe. Flow is measured on a small image, so these are fractions of the image width."""

    min_flow: float = 0.03  # median motion of tracked corners since the last keyframe
    min_flow_with_odometry: float = 0.2  # gyroscope and wheels hold keyframes together that share less
    min_tracked: float = 0.5  # fewer of the last keyframe's corners left: take one now
    track_width_px: int = 320  # images are tracked at this width: 3 ms each
    num_corners: int = 150
    max_interval_s: float = 2.0  # also while little moves, so that a slow approach is not lost


@dataclass(frozen=True, slots=True)
class FeatureConfig:
    """SIFT. Measured: `first_octave=0` is 4 times as fast as -1 and finds the larger, more repeatable half."""

    max_features: int = 1200
    peak_threshold: float = 0.0033  # half of COLMAP's: indoor walls have little contrast
    first_octave: int = 0


@dataclass(frozen=True, slots=True)
class SfmConfig:
    """All settings of a run; stored in `navigation.json`."""

    seed: int = 0
    threads: int = -1  # 1: the same result at every run, as far as COLMAP allows
    refine_intrinsics: bool | None = None  # None: as the dataset says
    keyframes: KeyframeConfig = field(default_factory=KeyframeConfig)
    features: FeatureConfig = field(default_factory=FeatureConfig)
    matching: MatchConfig = field(default_factory=MatchConfig)
    max_reprojection_error_px: float = 3.0
    min_track_length: int = 3
    min_triangulation_angle_deg: float = 1.5

    @property
    def mapping(self) -> MappingConfig:
        return MappingConfig(self.seed, self.matching, self.min_track_length, self.min_triangulation_angle_deg)
