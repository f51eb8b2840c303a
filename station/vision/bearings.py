"""Rays by azimuth and elevation, with derivatives: a camera's x is right, its y down, its z along the view. Pure.

Equation numbers: of the thesis.
"""

from __future__ import annotations

import numpy as np

from shared.geometry import FloatArray


def bearing(theta_phi: FloatArray) -> FloatArray:
    """m(theta, phi) (..., 3) of azimuth and elevation (..., 2) rad. Eq. C.4."""
    theta, phi = theta_phi[..., 0], theta_phi[..., 1]
    return np.stack([np.cos(phi) * np.sin(theta), -np.sin(phi), np.cos(phi) * np.cos(theta)], axis=-1)


def bearing_by_angles(theta_phi: FloatArray) -> FloatArray:
    """Derivative (..., 3, 2) of eq. C.4."""
    theta, phi = theta_phi[..., 0], theta_phi[..., 1]
    by_theta = np.stack([np.cos(phi) * np.cos(theta), np.zeros_like(phi), -np.cos(phi) * np.sin(theta)], axis=-1)
    by_phi = np.stack([-np.sin(phi) * np.sin(theta), -np.cos(phi), -np.sin(phi) * np.cos(theta)], axis=-1)
    return np.stack([by_theta, by_phi], axis=-1)


def angles_of(ray: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Azimuth and elevation (N, 2) of rays (N, 3), the inverse of eq. C.4, and the derivative (N, 2, 3)."""
    x, y, z = ray.T
    angles = np.stack([np.arctan2(x, z), np.arctan2(-y, np.hypot(x, z))], axis=1)
    across = bearing_by_angles(angles)  # its two columns are at right angles to each other and to the ray
    length2 = (across**2).sum(axis=1) * np.linalg.norm(ray, axis=1)[:, None]
    return angles, np.swapaxes(across / length2[:, None], 1, 2)
