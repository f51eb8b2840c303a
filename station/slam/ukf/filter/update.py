"""The square-root update and its gates (docs/slam.md, sec. 4).

With P = S S^T, whitened residual r and A = H S:  M = I + A^T A = C C^T,  dx = S M^-1 A^T r,  S+ = S C^-T.
P+ = S M^-1 S^T is the Kalman update; M's eigenvalues are at least 1, so its Cholesky factor always exists and P+ stays
positive whatever the number of measurements. All of a frame's measurements enter at once.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri

from shared.geometry import FloatArray
from station.motion.error_coordinates import ErrorKind
from station.slam.ukf.filter.roots import InformationRoot
from station.slam.ukf.filter.state import FilterState, retract
from station.vision.lens import BoolArray

MAX_DOF = 120


class Gate:
    """Chi-square thresholds for one probability."""

    def __init__(self, probability: float) -> None:
        self._limit = chdtri(np.arange(1, MAX_DOF + 1), 1.0 - probability)

    def limit(self, dof: np.ndarray[tuple[int, ...], np.dtype[np.int64]]) -> FloatArray:
        return self._limit[np.clip(dof, 1, MAX_DOF) - 1]


@dataclass(frozen=True, slots=True, eq=False)
class Measurements:
    """Whitened rows: residual r (m,) with unit noise, and A = H S (m, k)."""

    r: FloatArray
    A: FloatArray

    @classmethod
    def none(cls, state: FilterState) -> Measurements:
        return cls(np.zeros(0), np.zeros((0, state.S.shape[1])))


def stack(parts: list[Measurements]) -> Measurements:
    return Measurements(np.concatenate([p.r for p in parts]), np.vstack([p.A for p in parts]))


def update(state: FilterState, kind: ErrorKind, measurements: Measurements) -> FilterState:
    """The Kalman update, with the covariance as its square root."""
    r, A = measurements.r, measurements.A
    if len(r) == 0:
        return state
    M = InformationRoot(A)
    dx = state.S @ M.solve(A.T @ r)
    return retract(kind, replace(state, S=M.divide(state.S)), dx)


def mahalanobis(r: FloatArray, A: FloatArray) -> FloatArray:
    """r^T (A A^T + I)^-1 r per group: r (N, d), A (N, d, k) -> (N,). Chi-square with d degrees when all is well."""
    innovation = A @ np.swapaxes(A, 1, 2)
    d = r.shape[1]
    innovation[:, np.arange(d), np.arange(d)] += 1.0
    return np.einsum("ni,ni->n", r, np.linalg.solve(innovation, r[..., None])[..., 0])


def huber_weights(distance2: FloatArray, dof: FloatArray, k: float) -> FloatArray:
    """Square roots of Huber's weights (N,) for groups with squared Mahalanobis distances and degrees of freedom."""
    root = np.sqrt(distance2 / np.maximum(dof, 1.0))
    return np.sqrt(np.minimum(1.0, k / np.maximum(root, 1e-12)))


def is_finite(state: FilterState) -> bool:
    """Whether nothing in the state overflowed."""
    return bool(np.isfinite(state.S).all() and np.isfinite(state.x).all() and np.isfinite(state.R).all())


def select(measurements_r: FloatArray, measurements_A: FloatArray, keep: BoolArray) -> Measurements:
    """Rows of the kept groups: r (N, d), A (N, d, k)."""
    return Measurements(measurements_r[keep].ravel(), measurements_A[keep].reshape(-1, measurements_A.shape[2]))
