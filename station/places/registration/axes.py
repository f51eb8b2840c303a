"""Which direction could be up, when nobody says: from the surfaces, as rooms are made of parallel and upright ones."""

from __future__ import annotations

import numpy as np

from shared.geometry import FloatArray, upright
from station.places.registration.cloud import PreparedCloud

NUM_DIRECTIONS = 600
KERNEL = 60.0  # concentration of a normal around an axis: about 7 degrees


def upright_rotations(target: PreparedCloud, source: PreparedCloud) -> tuple[FloatArray, list[FloatArray]]:
    """Rotation (3, 3) that puts the target's strongest axis upright, and those of the source to try with it."""
    R_target = upright(principal_axes(target)[0])
    options = [upright(sign * axis) for axis in principal_axes(source) for sign in (1.0, -1.0)]
    return R_target, options


def principal_axes(cloud: PreparedCloud) -> FloatArray:
    """(3, 3) rows: orthogonal directions most surfaces are normal to, strongest first."""
    flat = cloud.flatness > np.median(cloud.flatness)
    normals = cloud.normals[flat]
    normals = normals[:: max(1, len(normals) // 2000)]
    sphere = _half_sphere(NUM_DIRECTIONS)
    votes = np.exp(KERNEL * (np.abs(sphere @ normals.T) - 1)).sum(axis=1)
    first = _sharpen(sphere[int(np.argmax(votes))], normals)
    across = np.abs(sphere @ first) < 0.15
    second = _sharpen(sphere[across][int(np.argmax(votes[across]))], normals)
    second -= first * (first @ second)
    second /= np.linalg.norm(second)
    return np.array([first, second, np.cross(first, second)])


def _sharpen(axis: FloatArray, normals: FloatArray) -> FloatArray:
    """Mean shift on the sphere, for directions without sign."""
    for _ in range(5):
        cosine = normals @ axis
        w = np.exp(KERNEL * (np.abs(cosine) - 1)) * np.sign(cosine)
        axis = (w[:, None] * normals).sum(axis=0)
        axis = axis / np.linalg.norm(axis)
    return axis


def _half_sphere(count: int) -> FloatArray:
    """Evenly spread directions (Fibonacci), upper half."""
    k = np.arange(count) + 0.5
    z = k / count
    angle = np.pi * (1 + np.sqrt(5)) * k
    r = np.sqrt(1 - z**2)
    return np.column_stack([r * np.cos(angle), r * np.sin(angle), z])
