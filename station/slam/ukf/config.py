"""All settings of the backend, with those of its parts; stored in `navigation.json`."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

from station.slam.ukf.filter.config import FilterConfig
from station.slam.ukf.filter.constraints import WheelConfig
from station.slam.ukf.map.landmark_map import LandmarkQuality
from station.slam.ukf.map.views import ViewConfig
from station.slam.ukf.start.motion_start import StartConfig
from station.vision.klt import MIN_FOLLOWED, TrackerConfig


@dataclass(frozen=True, slots=True)
class UkfConfig:
    filter: FilterConfig = field(default_factory=FilterConfig)
    tracker: TrackerConfig = field(default_factory=TrackerConfig)
    start: StartConfig = field(default_factory=StartConfig)
    wheels: WheelConfig = field(default_factory=WheelConfig)  # without wheels, only what it says of standing still
    quality: LandmarkQuality = field(default_factory=LandmarkQuality)
    landmarks: Literal["default", "thesis"] = "default"  # thesis: each landmark as it first entered the filter
    # views: loops are closed and landmarks come from SIFT features; it costs about as much as the filter does.
    # auto: views for a robot with wheels, which comes back to where it was; tracks else.
    map: Literal["auto", "tracks", "views"] = "auto"
    views: ViewConfig = field(default_factory=ViewConfig)
    # Visual-inertial least squares over the keyframes when the drive ends. Not on wheels, where the filter knows more
    # (docs/studies/ukf.md).
    refine: bool = True
    max_keyframes: int = 500
    max_outage_s: float = 0.6  # without features for longer, tracking is lost
    max_outage_wheels_s: float = 8.0  # the same where wheels say how fast it goes: 5 cm off by then, of 2.4 m
    max_covered_s: float = 1.8  # of that robot, when its lens is covered
    max_climb_m_s: float = 0.2  # a wheeled robot that rises or sinks that fast is being carried
    min_upright: float = 0.985  # cosine of its tilt; 10 degrees
    min_features: int = MIN_FOLLOWED  # fewer followed features than this count as an outage
    max_speed_m_s: float = 15.0
    max_disagreements: int = 5  # consecutive frames in which most landmarks fail their gate
    max_imu_gap_s: float = 0.5  # without IMU for longer, tracking is lost
    # The camera of a small robot (rolling shutter, blur in turns, JPEG) makes tracks drift that a global-shutter camera
    # holds (docs/studies/ukf.md).
    sigma_px_wheels: float = 1.5

    def for_robot(self, has_wheels: bool) -> UkfConfig:
        if not has_wheels:
            return self
        calmer = replace(self.filter, sigma_px=max(self.filter.sigma_px, self.sigma_px_wheels))
        return replace(self, filter=calmer, refine=False)
