"""Settings of the mono backend; stored in `navigation.json`. Its unit of length is arbitrary: "units" below."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True, slots=True)
class FilterConfig:
    """Motion model, noise and map of the filter."""

    sigma_accel: float = 4.0  # units/s^2, of the unknown acceleration (eq. 2.1)
    sigma_angular_accel: float = 6.0  # rad/s^2, the same for turning (eq. 2.1)
    sigma_first_velocity: float = 1.0  # units/s, before the first image pair
    sigma_first_turn: float = 1.0  # rad/s
    sigma_px: float = 1.0  # R of eq. 2.6 until the start has measured it
    min_sigma_px: float = 0.2  # no smaller: what patches are off by hardly changes from picture to picture
    # After how many the first images are gone through again; doubling, as what a path tells grows with its length.
    start_images: tuple[int, ...] = (10, 20, 40)
    first_inverse_depth: float = 0.3  # 1/units, of a new feature (C.2)
    sigma_first_inverse_depth: float = 0.3  # one of them reaches to infinity
    max_linearity: float = 0.1  # below, a feature becomes XYZ (Civera et al. 2008, eq. 28)
    num_measured: int = 40  # features in a frame, at most and, where the picture has them, at least
    max_features: int = 100  # in the state
    gate_sigmas: float = 3.0  # the search ellipse
    rescue_chi2: float = 9.21  # 99 % of two degrees of freedom
    min_tries: int = 8  # before a feature can be given up for being found too rarely
    min_found_share: float = 0.5
    memory: int = 20  # images over which a right feature's errors average out;
    max_mean_sigmas: float = 1.0  # a corner where two depths meet slides, and its errors do not


@dataclass(frozen=True, slots=True)
class SearchConfig:
    """Patches and where new ones are taken; pixels of the image as delivered."""

    patch_px: int = 13  # side of the template that is looked for
    margin_px: int = 8  # kept around it, so that it can be warped
    min_correlation: float = 0.8
    max_reach_px: int = 40  # half a side of the searched rectangle, at most
    max_stretch: float = 2.0  # a view that enlarges or shrinks a patch more is not compared
    cell_px: int = 56  # one new feature per empty cell
    min_response: float = 3e-4  # Shi-Tomasi eigenvalue below which a corner is noise


@dataclass(frozen=True, slots=True)
class MonoConfig:
    filter: FilterConfig = field(default_factory=FilterConfig)
    search: SearchConfig = field(default_factory=SearchConfig)
    keyframe_flow: float = 0.05  # of the image width; the median feature moved that much since the last keyframe
    keyframe_share: float = 0.6  # or fewer of its features are left
    min_found: int = 6  # fewer found features than this
    max_outage_s: float = 0.5  # for that long: tracking is lost
    max_gap_s: float = 0.5  # between two images: no motion model reaches across
    min_observations: int = 3  # keyframes that saw a landmark
    max_depth_sigma: float = 0.25  # relative; a landmark that is known worse is left out
