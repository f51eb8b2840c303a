"""The fitted numbers of images' evidence: all of them, as `benchmarks/fit_image_evidence.py` writes `fitted.json`."""

from __future__ import annotations

from pathlib import Path

import msgspec

GENERATED = Path(__file__).with_name("fitted.json")


class RecognisedOdds(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Log odds of a verified pose, linear in what its figures tell (`image_evidence.terms`, in the same order)."""

    constant: float
    extent: float
    inliers: float
    support: float
    features: float
    off_floor: float
    free: float


class FailureOdds(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Log odds that an image is not recognised."""

    constant: float
    features: float  # of the logarithm of their number
    again: float  # the image before was not recognised
    in_view: float = 0.0  # of the logarithm of what should be in view


class Usual(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Medians of right poses, for what nobody knows of a pose."""

    support: float  # in maps that do not say what should be in view
    off_floor: float  # of robots of which nobody knows how they stand


class FittedOdds(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How the figures of images tell where they were taken, and from what data that was learnt."""

    made_by: str  # the command
    worlds: tuple[str, ...]  # kinds and seeds
    log_loss: dict[str, float]  # of each regression, nats per image, every kind of world by what the others say
    usual: Usual
    right: RecognisedOdds  # that the pose is right, against a look-alike
    tried: float  # what is added to them for a map's own pictures, tried in it, in all maps alike (`own_pictures.py`)
    unmapped: RecognisedOdds  # that no map knows where the image was taken, against somewhere in a map
    fails_at_pose: FailureOdds
    fails_in_map: FailureOdds  # at a pose that nobody knows
    fails_unmapped: FailureOdds


def read_fitted(path: Path = GENERATED) -> FittedOdds:
    """Raises msgspec.ValidationError where the file has other fields than this code reads."""
    return msgspec.json.decode(path.read_bytes(), type=FittedOdds)
