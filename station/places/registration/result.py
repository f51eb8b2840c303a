"""What a registration answers. A failed one is a value with reasons, never an identity matrix."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np

from shared.geometry import FloatArray

Scale = Literal["known", "free"]
Gravity = Literal["known", "unknown"]
Backend = Literal["small_gicp", "open3d"]


@dataclass(frozen=True, slots=True, eq=False)
class Alternative:
    """Another way the clouds could lie on each other, and how well it explains them (0..1)."""

    T_target_source: FloatArray  # (4, 4) with scale
    score: float


@dataclass(frozen=True, slots=True, eq=False)
class Registration:
    """How the source cloud lies in the target's frame, and whether that may be believed."""

    accepted: bool
    reasons: tuple[str, ...]  # why not; for an accepted one, what speaks for it
    T_target_source: FloatArray | None  # (4, 4), upper-left 3x3 is scale * R; None: no candidate at all
    scale: float
    rmse: float  # of inliers along the target's surface normals, target units
    inlier_ratio: float  # share of the source's points in the shared space that lie on the target's surfaces
    confidence: float  # probability that the alignment is right, as learned from synthetic pairs
    measured: dict[str, float]  # what that is made from (Findings.features), and by the checks (Verdict.checked)
    overlap: float  # share of points with a neighbour in the other cloud, the smaller of both directions
    # (7, 7) of (rotation rad, translation of the shared points' middle, log scale), target frame; fixed ones are 0.
    # Where images decided: of the middle of the cameras that agree.
    covariance: FloatArray | None
    eigenvalues: FloatArray | None  # of the normal equations per inlier, ascending: a small one is a free direction
    backend: str
    score: float  # what candidates are ranked by: share of points that fit here and not beside it
    alternatives: tuple[Alternative, ...]

    def __str__(self) -> str:
        """For a person: a reason per line where there are several."""
        word = "accepted" if self.accepted else "refused"
        return f"{word}: {self.reasons[0]}" if len(self.reasons) == 1 else "\n  ".join([f"{word}:", *self.reasons])


@dataclass(frozen=True, slots=True)
class Uncertainty:
    """One standard deviation each, along the least certain direction."""

    rotation_rad: float
    position: float  # target units
    scale: float  # relative


def uncertainty_of(registration: Registration) -> Uncertainty | None:
    """How far the alignment may be off, if it is the right one; None where that is not known."""
    C = registration.covariance
    if C is None or not np.isfinite(C).all():
        return None
    largest = [float(np.linalg.eigvalsh(block)[-1]) for block in (C[:3, :3], C[3:6, 3:6], C[6:, 6:])]
    return Uncertainty(*(float(np.sqrt(max(value, 0.0))) for value in largest))


def registration_json(registration: Registration) -> dict[str, Any]:
    """What `station register` and the results of an experiment say of it."""
    uncertainty = uncertainty_of(registration)
    return {
        "accepted": registration.accepted,
        "reasons": list(registration.reasons),
        "T_target_source": _listed(registration.T_target_source),
        "scale": registration.scale,
        "rmse": finite(registration.rmse),
        "inlier_ratio": registration.inlier_ratio,
        "overlap": registration.overlap,
        "backend": registration.backend,
        "uncertainty": None if uncertainty is None else asdict(uncertainty),
        "covariance": _listed(registration.covariance),
    }


def finite(value: float) -> float | None:
    """JSON knows no NaN."""
    return float(value) if np.isfinite(value) else None


def _listed(array: FloatArray | None) -> Any:
    return None if array is None else array.tolist()


def refused(reason: str, backend: str) -> Registration:
    """A registration that found nothing to even judge."""
    return Registration(False, (reason,), None, 1.0, float("nan"), 0.0, 0.0, {}, 0.0, None, None, backend, 0.0, ())
