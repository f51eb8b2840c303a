"""How places are made. One default configuration for every scene; the thesis' numbers are its own mode."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Literal

from shared.errors import ConfigError

PlacesMode = Literal["thesis", "default"]
AlignBy = Literal["both", "geometry", "appearance"]


@dataclass(frozen=True, slots=True)
class ThesisConfig:
    """Chapter 5's hand-set numbers; the defaults are experiment I's."""

    eps: float = 0.3  # metres, or normalised units where the scale is arbitrary
    min_pts: int = 11  # a core point has at least so many points, itself included, within eps
    inlier_ratio: float = 0.75  # share of the closest pairs registration keeps
    normalise: bool | None = None  # centre and normalise clouds; None: where the scale is arbitrary

    def __post_init__(self) -> None:
        if not self.eps > 0:
            raise ConfigError(f"eps is {self.eps}, must be above 0")
        if self.min_pts < 1:
            raise ConfigError(f"min_pts is {self.min_pts}, must be 1 or more")
        if not 0 < self.inlier_ratio <= 1:
            raise ConfigError(f"inlier_ratio is {self.inlier_ratio}, must lie in (0, 1]")


@dataclass(frozen=True, slots=True)
class PlacesConfig:
    """Everything `build_map` and matching may be told. No length in here: lengths come from the cloud."""

    mode: PlacesMode = "default"
    thesis: ThesisConfig = field(default_factory=ThesisConfig)
    align_by: AlignBy = "both"  # default mode: images find the map first, clouds otherwise; or only one of the two
    # The two factors exist for sensitivity studies (docs/studies/places.md); nobody needs to set them.
    eps_factor: float = 1.0  # on the neighbourhood that the cloud's density asks for
    size_factor: float = 1.0  # on the size of a place that the viewing distance asks for
    voxelise_above: int = 100_000  # points; DBSCAN and hill climbing slow down beyond (docs/places.md)

    def __post_init__(self) -> None:
        if self.mode not in ("thesis", "default"):
            raise ConfigError(f'mode is "{self.mode}", must be "thesis" or "default"')
        if self.align_by not in ("both", "geometry", "appearance"):
            raise ConfigError(f'align_by is "{self.align_by}", must be "both", "geometry" or "appearance"')
        for name in ("eps_factor", "size_factor"):
            if not getattr(self, name) > 0:
                raise ConfigError(f"{name} is {getattr(self, name)}, must be above 0")

    def as_dict(self) -> dict[str, object]:
        return asdict(self)
