"""The options of clustering and matching, as several commands take them."""

from __future__ import annotations

from shared.errors import ConfigError
from station.places.making.config import AlignBy, PlacesConfig, PlacesMode, ThesisConfig


def places_config(mode: str, eps: float, min_pts: int, inlier_ratio: float, align_by: str = "both") -> PlacesConfig:
    """Configuration from command-line options. Raises ConfigError naming the one that is wrong."""
    return PlacesConfig(
        mode=places_mode(mode),
        align_by=align_by_mode(align_by),
        thesis=ThesisConfig(eps=eps, min_pts=min_pts, inlier_ratio=inlier_ratio),
    )


def places_mode(text: str) -> PlacesMode:
    """The mode by name. Raises ConfigError for any other word."""
    if text == "thesis":
        return "thesis"
    if text == "default":
        return "default"
    raise ConfigError(f'--mode is "{text}", must be "thesis" or "default"')


def align_by_mode(text: str) -> AlignBy:
    """What registration looks at, by name. Raises ConfigError for any other word."""
    for known in ("both", "geometry", "appearance"):
        if text == known:
            return known
    raise ConfigError(f'--align-by is "{text}", must be "both", "geometry" or "appearance"')
