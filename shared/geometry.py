"""Motions and rotations as plain arrays: `T_a_b` (4, 4) maps b to a. docs/conventions.md has the rules.

A similarity, Sim(3), is a rigid motion whose upper-left block carries a scale too: scale * R. Products and `transform`
are the same for both; what differs is here.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

MIN_LEVEL = 0.31  # an axis whose horizontal part is shorter, 18 degrees from the vertical, has no yaw to speak of
SMALL_ANGLE_RAD = 1e-6  # below it the series of Rodrigues' formula is exact to double precision


def se3(R: FloatArray, t: FloatArray) -> FloatArray:
    """Rotation (3, 3) and translation (3,) as a homogeneous matrix (4, 4)."""
    T = np.eye(4)
    T[:3, :3] = R
    T[:3, 3] = t
    return T


def inverse(T: FloatArray) -> FloatArray:
    """Inverse of rigid motions (..., 4, 4): `inverse(T_a_b)` is `T_b_a`."""
    R_t = np.swapaxes(T[..., :3, :3], -1, -2)
    out = np.zeros_like(T)
    out[..., :3, :3] = R_t
    out[..., :3, 3] = -(R_t @ T[..., :3, 3, None])[..., 0]
    out[..., 3, 3] = 1.0
    return out


def transform(T_a_b: FloatArray, p_b: FloatArray) -> FloatArray:
    """Points (..., 3) of frame b in frame a; T may be a similarity."""
    return p_b @ T_a_b[:3, :3].T + T_a_b[:3, 3]


def sim3(scale: float, R: FloatArray, t: FloatArray) -> FloatArray:
    """The similarity (4, 4) p -> scale * R p + t."""
    return se3(scale * R, t)


def scale_of(T: FloatArray) -> float:
    """The scale of a similarity (4, 4); 1 of a rigid motion."""
    return float(np.cbrt(np.linalg.det(T[:3, :3])))


def rotation_of(T: FloatArray) -> FloatArray:
    """The rotation (3, 3) of a similarity (4, 4)."""
    return T[:3, :3] / scale_of(T)


def inverse_sim3(T: FloatArray) -> FloatArray:
    """Inverse of a similarity (4, 4)."""
    scale = scale_of(T)
    back = inverse(se3(rotation_of(T), T[:3, 3] / scale))
    back[:3, :3] /= scale
    return back


def carry_poses(T_a_b: FloatArray, T_b_c: FloatArray) -> FloatArray:
    """Rigid poses (N, 4, 4) of c in frame a; the scale of T_a_b moves positions and leaves rotations rigid."""
    out = T_b_c.copy()
    out[:, :3, :3] = rotation_of(T_a_b) @ T_b_c[:, :3, :3]
    out[:, :3, 3] = transform(T_a_b, T_b_c[:, :3, 3])
    return out


def skew(v: FloatArray) -> FloatArray:
    """Cross-product matrix (3, 3) of v (3,): `skew(v) @ w == cross(v, w)`. Thesis eq. B.1."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Cross products of rows (N, 3); NumPy's own takes several times as long."""
    out = np.empty_like(a)
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        out[:, i] = a[:, j] * b[:, k] - a[:, k] * b[:, j]
    return out


def orthonormal(M: FloatArray) -> FloatArray:
    """The rotation (3, 3) nearest to M in the Frobenius norm. Source: Umeyama, IEEE TPAMI 13(4), 1991, lemma."""
    U, _, Vt = np.linalg.svd(M)
    return U @ np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))]) @ Vt


def rotation_angle(R: FloatArray) -> FloatArray:
    """Angles (...) rad, 0 to pi, of rotations (..., 3, 3). Near 0 and pi `so3_log` is more exact: here 1e-8 is lost."""
    return np.asarray(np.arccos(np.clip((np.trace(R, axis1=-2, axis2=-1) - 1.0) / 2.0, -1.0, 1.0)))


def so3_exp(phi: FloatArray) -> FloatArray:
    """Rotation (3, 3) of the rotation vector phi (3,) rad. Thesis eq. B.2 (Rodrigues)."""
    angle = float(np.linalg.norm(phi))
    S = skew(phi)
    if angle < SMALL_ANGLE_RAD:
        return np.eye(3) + S + 0.5 * S @ S
    return np.eye(3) + (np.sin(angle) / angle) * S + ((1.0 - np.cos(angle)) / angle**2) * S @ S


def so3_log(R: FloatArray) -> FloatArray:
    """Rotation vector (3,) rad, length at most pi, of the rotation (3, 3). Thesis eq. B.4, by quaternion near pi."""
    q = quat_from_rotation(R)
    w, v = q[0], q[1:]
    sin_half = float(np.linalg.norm(v))
    if sin_half < SMALL_ANGLE_RAD:
        return 2.0 * v
    return v * (2.0 * np.arctan2(sin_half, w) / sin_half)


def quat_from_rotation(R: FloatArray) -> FloatArray:
    """Unit quaternion wxyz (4,), w >= 0, of the rotation (3, 3). Source: Shepperd, J. Guidance 1(3), 1978."""
    candidates = np.array([np.trace(R), R[0, 0], R[1, 1], R[2, 2]])
    k = int(np.argmax(candidates))
    if k == 0:
        q = np.array([1.0 + candidates[0], R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    else:
        i, j, m = k - 1, k % 3, (k + 1) % 3
        q = np.empty(4)
        q[0] = R[m, j] - R[j, m]
        q[1 + i] = 1.0 + R[i, i] - R[j, j] - R[m, m]
        q[1 + j] = R[j, i] + R[i, j]
        q[1 + m] = R[m, i] + R[i, m]
    q /= np.linalg.norm(q)
    return q if q[0] >= 0 else -q


def rotation_from_quat(q_wxyz: FloatArray) -> FloatArray:
    """Rotation (3, 3) of the quaternion wxyz (4,), which is normalised first."""
    w, x, y, z = q_wxyz / np.linalg.norm(q_wxyz)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def yaw_rotation(yaw_rad: float) -> FloatArray:
    """Rotation (3, 3) about the vertical (z) axis."""
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def median_radius(p: FloatArray) -> float:
    """Median distance of points (N, 3) from their middle: how large a cloud is, whatever a few points do."""
    return float(np.median(np.linalg.norm(p - np.median(p, axis=0), axis=1)))


def upright(up: FloatArray, R_a_body: FloatArray | None = None) -> FloatArray:
    """Rotation (3, 3) from frame a to axes whose z points along `up` (3,), given in a, of any length.

    It is the shortest one. Or, given a body's axes R_a_body (3, 3), the one that puts the body's x axis at yaw 0; where
    that is too steep to have a yaw, the z axis, else the y axis.
    """
    up = up / np.linalg.norm(up)
    if R_a_body is None:
        axis = np.cross(up, [0.0, 0.0, 1.0])
        sine = float(np.linalg.norm(axis))
        if sine < 1e-12:
            return np.eye(3) if up[2] > 0 else np.diag([1.0, -1.0, -1.0])
        return so3_exp(axis * (float(np.arctan2(sine, up[2])) / sine))
    for forward in R_a_body.T[[0, 2, 1]]:
        x = forward - up * (forward @ up)
        length = float(np.linalg.norm(x))
        if length > MIN_LEVEL:
            break
    x /= length
    return np.stack([x, np.cross(up, x), up])
