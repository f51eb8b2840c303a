"""The thesis' registration: plane-to-plane ICP from identity with an inlier ratio (4.3.5-4.3.7)."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from shared.errors import EstimationError
from shared.geometry import FloatArray, inverse_sim3, scale_of, sim3, transform
from station.places.making.clusters import centre_and_normalise
from station.places.making.config import ThesisConfig
from station.places.registration.gicp import align_gicp
from station.places.registration.result import Registration, refused

MAX_ROUNDS = 30
MIN_POINTS = 12  # GICP needs as many neighbours for a point's covariance
CONVERGED = 1e-5  # of the cloud's size: the pose no longer moves
COINCIDE = 1e-9  # of the cloud's size: nothing is left to move


def register_as_thesis(
    target: FloatArray, source: FloatArray, config: ThesisConfig, *, normalise: bool
) -> Registration:
    """Register source (M, 3) to target (N, 3) by GICP from identity; with `normalise`, after centring and normalising.

    MATLAB's inlier ratio (the share of the closest pairs that takes part in each step) is made of rounds here: the
    library's distance limit is set to that quantile of the current distances. Always accepted: the thesis checks
    by eye. A cloud of fewer than 12 points is refused.
    """
    target, source = target[np.isfinite(target).all(axis=1)], source[np.isfinite(source).all(axis=1)]
    if min(len(target), len(source)) < MIN_POINTS:
        return refused(f"{min(len(target), len(source))} points are too few to register", "small_gicp")
    T_unit_target, T_unit_source = np.eye(4), np.eye(4)
    if normalise:
        T_unit_target, T_unit_source = _normalisation(target), _normalisation(source)
    A, B = transform(T_unit_target, target), transform(T_unit_source, source)
    tree = cKDTree(A)
    size = float(np.linalg.norm(np.ptp(A, axis=0)))
    T = np.eye(4)
    for _ in range(MAX_ROUNDS):
        distance = tree.query(transform(T, B))[0]
        reach = float(np.quantile(distance, config.inlier_ratio))
        kept = distance <= reach
        if reach < COINCIDE * size or np.count_nonzero(kept) < MIN_POINTS:
            break
        try:
            T_next = align_gicp(A, B[kept], T, reach=reach, backend="small_gicp")
        except EstimationError as exc:
            return refused(str(exc), "small_gicp")
        moved = float(np.abs(transform(T_next, B) - transform(T, B)).max())
        T = T_next
        if moved < CONVERGED * size:
            break
    distance = tree.query(transform(T, B))[0]
    kept = distance <= np.quantile(distance, config.inlier_ratio)
    T_target_source = inverse_sim3(T_unit_target) @ T @ T_unit_source
    return Registration(
        accepted=True,
        reasons=("thesis mode: not verified, judge by eye",),
        T_target_source=T_target_source,
        scale=scale_of(T_target_source),
        rmse=float(np.sqrt((distance[kept] ** 2).mean())),  # in the units registered in: normalised ones in the thesis
        inlier_ratio=config.inlier_ratio,
        confidence=float("nan"),
        evidence={},
        overlap=float(np.mean(distance <= 3 * np.median(distance))),
        covariance=None,
        eigenvalues=None,
        backend="small_gicp",
        score=float("nan"),
        alternatives=(),
    )


def _normalisation(p: FloatArray) -> FloatArray:
    """(4, 4) that centres and normalises the cloud."""
    _, centre, scale = centre_and_normalise(p)
    return sim3(1 / scale, np.eye(3), -centre / scale)
