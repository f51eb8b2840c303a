"""Settings of the backend; stored in `navigation.json`."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from station.slam.ukf.config import UkfConfig


@dataclass(frozen=True, slots=True)
class RecallConfig:
    """How landmarks whose track ended are looked for again."""

    max_candidates: int = 80  # per keyframe, those nearest in view to how they were last seen
    patch_px: int = 11  # side of what is compared
    stored_px: int = 27  # side of what is kept of the image: a patch turned by 45 degrees and half again as large fits
    min_correlation: float = 0.8
    max_ratio: float = 0.92  # of the second best place's correlation to the best one's
    max_view_angle_deg: float = 40.0
    max_stretch: float = 1.8
    reach_px: float = 8.0  # around the prediction
    old_reach_px: float = 16.0  # of landmarks that have left the window: the path has drifted since
    min_agreeing: int = 8  # of those that must agree on one pose
    agree_px: float = 2.5


@dataclass(frozen=True, slots=True)
class SmoothingConfig:
    """Keyframes, window, gates."""

    odometry: UkfConfig = field(default_factory=UkfConfig)
    recall: RecallConfig = field(default_factory=RecallConfig)
    min_interval_s: float = 0.14  # 7 keyframes per second
    max_interval_s: float = 0.5
    min_flow: float = 0.01  # fraction of the image width; less between the two intervals makes no keyframe
    lag_s: float = 3.0  # 4 s cost more and gave no better live poses (decision 0022)
    sigma_px: float = 1.0
    huber: float = 1.5  # sigmas
    gate: float = 4.0  # sigmas of a reprojection, before it enters the graph
    gate_trusted: float = 40.0  # of landmarks found again that agree on one pose
    max_depth_sigma: float = 0.25  # relative; of a track that becomes a landmark
    min_views: int = 3
    sigma_landmark_share: float = 0.5  # weak prior by depth, without which a landmark seen from afar is indeterminate
    # It counts what a landmark's views say of its depth twice. Wheels tell the scale; landmarks must not hold it.
    sigma_landmark_share_wheels: float = 100.0
    sigma_recalled_m: float = 0.02  # of a landmark found again after it had left the window, besides its own
    # Off: frames take up to 0.1 s longer, and what is believed comes too late to help (decision 35).
    closes_loops: bool = False
    max_keyframes: int = 300  # solved together when the drive ends; of a longer one every second is left out, and so on

    def for_robot(self, has_wheels: bool) -> SmoothingConfig:
        """What the filter takes for the noise of this robot's pictures is theirs here, too."""
        odometry = self.odometry.for_robot(has_wheels)
        share = self.sigma_landmark_share_wheels if has_wheels else self.sigma_landmark_share
        return replace(self, odometry=odometry, sigma_px=odometry.filter.sigma_px, sigma_landmark_share=share)
