"""Settings of the mono backend; stored in `navigation.json`. Its unit of length is arbitrary: "units" below."""

from __future__ import annotations

from dataclasses import dataclass, field

from station.slam.ukf.map.landmark_map import LandmarkQuality


@dataclass(frozen=True, slots=True)
class MonoConfig:
    sigma_accel: float = 4.0  # units/s^2, of the unknown acceleration (eq. 2.1)
    sigma_angular_accel: float = 6.0  # rad/s^2, the same for turning (eq. 2.1)
    sigma_first_velocity: float = 1.0  # units/s, before the first image pair
    sigma_first_turn: float = 1.0  # rad/s
    sigma_px: float = 1.0  # R of eq. 2.6, times State.noise, until a window has measured it
    min_sigma_px: float = 0.16  # a patch errs alike in some pictures in a row, which says less than new errors would
    window_images: tuple[int, ...] = (10, 20, 40)  # after so many a window is gone through again; it ends with the last
    first_inverse_depth: float = 0.3  # 1/units, of a new feature (C.2)
    sigma_first_inverse_depth: float = 0.3  # one of them reaches to infinity
    max_linearity: float = 0.1  # below, a feature becomes XYZ (Civera et al. 2008, eq. 28)
    num_measured: int = 40  # features in a frame, at most and, where the picture has them, at least
    max_features: int = 140  # in the state
    agree_chi2: float = 9.21  # 99 % of two degrees of freedom; what contradicts the others more is wrong
    min_tries: int = 8  # before a feature can be given up for being found too rarely
    min_found_share: float = 0.5
    min_found: int = 6  # fewer found features say too little of how the camera moved
    max_outage_s: float = 0.5  # for that long: tracking is lost
    gate_sigmas: float = 3.0  # size of the search ellipse
    coarse: int = 4  # where corners are too few, the picture shrunk so many times is searched for shades
    coarse_blur: float = 1.5  # pixels of the shrunk picture: noise changes faster than what is left
    min_response: float = 3e-4  # Shi-Tomasi eigenvalue below which a sharp corner is noise
    min_coarse_response: float = 2e-6  # a fifth of a grey level a pixel; noise leaves a twentieth
    grey_noise: float = 2.0  # grey levels, of the difference of two sharp pixels
    cell_px: int = 56  # one new feature per empty cell
    patch_px: int = 13  # side of the template that is looked for
    margin_px: int = 8  # kept around it, so that it can be warped
    min_correlation: float = 0.8
    max_stretch: float = 4.0  # a view that enlarges or shrinks a patch's area more is not compared
    max_reach_px: int = 40  # half a side of the searched rectangle, at most
    keyframe_flow: float = 0.05  # of the image width; half the last keyframe's features moved that much, or are gone
    landmarks: LandmarkQuality = field(default_factory=LandmarkQuality)
