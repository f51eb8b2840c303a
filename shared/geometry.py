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
SMALL_ANGLE_RAD = 1e-4  # below it series with terms up to angle^4 are exact to double precision
MAX_QUAT_ERROR = 0.05  # of a length: files with two digits
MAX_ROTATION_ERROR = 1e-3
# Of what a file holds, metres or a map's units: a broken one has more, and what is computed overflows.
MAX_POSITION = 1e9
DIAGONAL = np.arange(3)


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


def homogeneous(xy: FloatArray) -> FloatArray:
    """Points (..., 3) at depth 1, or rays, through normalised image coordinates (..., 2)."""
    return np.concatenate([xy, np.ones((*xy.shape[:-1], 1))], axis=-1)


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
    """Cross-product matrices (..., 3, 3) of v (..., 3). Thesis eq. B.1."""
    S = np.zeros((*v.shape, 3))
    S[..., 0, 1], S[..., 0, 2] = -v[..., 2], v[..., 1]
    S[..., 1, 0], S[..., 1, 2] = v[..., 2], -v[..., 0]
    S[..., 2, 0], S[..., 2, 1] = -v[..., 1], v[..., 0]
    return S


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


def gammas(phi: FloatArray, orders: tuple[int, ...]) -> list[FloatArray]:
    """Gamma_m(phi) = sum_n [phi]x^n / (n + m)! for m of 0, 1, 2: the exponential and its m-fold integrals over time.

    Source: Bloesch et al., RSS 2012, appendix.
    """
    theta2 = np.einsum("...i,...i->...", phi, phi)
    theta = np.sqrt(theta2)
    near = theta < SMALL_ANGLE_RAD
    t = np.where(near, 1.0, theta)
    t2 = t * t
    sin, cos = np.sin(t), np.cos(t)
    S = skew(phi)
    SS = S @ S
    result = []
    for order in orders:
        if order == 0:
            a = np.where(near, 1.0 - theta2 / 6.0, sin / t)
            b = np.where(near, 0.5 - theta2 / 24.0, (1.0 - cos) / t2)
        elif order == 1:
            a = np.where(near, 0.5 - theta2 / 24.0, (1.0 - cos) / t2)
            b = np.where(near, 1.0 / 6.0 - theta2 / 120.0, (t - sin) / (t2 * t))
        else:
            a = np.where(near, 1.0 / 6.0 - theta2 / 120.0, (t - sin) / (t2 * t))
            # 0.5 t^2 + cos - 1 loses all digits below about 0.1 rad: series to t^4 there
            series = 1.0 / 24.0 - theta2 / 720.0 + theta2 * theta2 / 40320.0
            b = np.where(theta < 0.1, series, (0.5 * t2 + cos - 1.0) / (t2 * t2))
        gamma = a[..., None, None] * S + b[..., None, None] * SS
        gamma[..., DIAGONAL, DIAGONAL] += 0.5 if order == 2 else 1.0
        result.append(gamma)
    return result


def so3_exp(phi: FloatArray) -> FloatArray:
    """Rotations (..., 3, 3) of rotation vectors (..., 3) rad. Thesis eq. B.2 (Rodrigues)."""
    return gammas(phi, (0,))[0]


def so3_log(R: FloatArray) -> FloatArray:
    """Rotation vectors (..., 3) rad, length at most pi, of rotations (..., 3, 3). Thesis eq. B.4 away from pi."""
    vee = 0.5 * np.stack(
        [R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]], axis=-1
    )
    sin = np.linalg.norm(vee, axis=-1)
    cos = 0.5 * (np.trace(R, axis1=-2, axis2=-1) - 1.0)
    theta = np.arctan2(sin, cos)
    factor = np.where(sin < 1e-8, 1.0 + theta * theta / 6.0, theta / np.where(sin < 1e-8, 1.0, sin))
    out = factor[..., None] * vee
    far = cos < -0.99
    if np.any(far):
        out = np.where(far[..., None], _log_near_pi(R, vee, theta), out)
    return out


def _log_near_pi(R: FloatArray, vee: FloatArray, theta: FloatArray) -> FloatArray:
    """Near pi the antisymmetric part vanishes: the axis comes from R + R^T = 2 cos I + 2 (1 - cos) a a^T."""
    symmetric = 0.5 * (R + np.swapaxes(R, -1, -2))
    cos = np.cos(theta)[..., None, None]
    outer = (symmetric - cos * np.eye(3)) / np.maximum(1.0 - cos, 0.5)
    column = np.argmax(np.diagonal(outer, axis1=-2, axis2=-1), axis=-1)
    axis = np.take_along_axis(outer, column[..., None, None], axis=-1)[..., 0]
    axis = axis / np.maximum(np.linalg.norm(axis, axis=-1, keepdims=True), 1e-12)
    sign = np.where(np.einsum("...i,...i->...", axis, vee) < 0.0, -1.0, 1.0)
    return (sign * theta)[..., None] * axis


def slerp(R_a: FloatArray, R_b: FloatArray, fraction: float | FloatArray) -> FloatArray:
    """Rotations (..., 3, 3) at a fraction (...), 0 to 1, of the shortest way from R_a to R_b."""
    turn = so3_log(np.swapaxes(R_a, -1, -2) @ R_b)
    return R_a @ so3_exp(np.asarray(fraction)[..., None] * turn)


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


def pose(t: FloatArray, q_wxyz: FloatArray) -> FloatArray:
    """A pose (4, 4) out of a file: position (3,) and quaternion (4,). Raises ValueError where they are none."""
    off = abs(np.linalg.norm(np.clip(q_wxyz, -2.0, 2.0)) - 1.0)  # 1e308 would overflow, and is as wrong as 2
    if not (np.abs(t) < MAX_POSITION).all() or not off < MAX_QUAT_ERROR:  # NaN fails as well
        raise ValueError(f"position {t.tolist()} with quaternion {q_wxyz.tolist()} (w x y z) is no pose")
    return se3(rotation_from_quat(q_wxyz), t)


def poses(t: FloatArray, q_wxyz: FloatArray) -> FloatArray:
    """Poses (N, 4, 4) out of a file, to the last bit those of `pose`: positions (N, 3), quaternions (N, 4)."""
    lengths = _lengths(np.clip(q_wxyz, -2.0, 2.0))[:, 0]  # as in `pose`
    fits = (np.abs(t) < MAX_POSITION).all(axis=1) & (np.abs(lengths - 1.0) < MAX_QUAT_ERROR)
    if not fits.all():
        first = int(np.argmin(fits))
        pose(t[first], q_wxyz[first])  # says what is wrong
    T = np.zeros((len(t), 4, 4))
    T[:, :3, :3], T[:, :3, 3], T[:, 3, 3] = rotation_from_quat(q_wxyz), t, 1.0
    return T


def are_poses(T: FloatArray) -> bool:
    """Whether these (N, 4, 4) are rigid motions within MAX_POSITION; False for any that is not finite."""
    R = T[:, :3, :3]
    off = np.abs(R @ R.swapaxes(1, 2) - np.eye(3)).max(initial=0.0)
    return bool((np.abs(T) < MAX_POSITION).all() and off < MAX_ROTATION_ERROR and (T[:, 3] == (0, 0, 0, 1)).all())


def rotation_from_quat(q_wxyz: FloatArray) -> FloatArray:
    """Rotations (..., 3, 3) of quaternions wxyz (..., 4), which are normalised first."""
    w, x, y, z = np.moveaxis(q_wxyz / _lengths(q_wxyz), -1, 0)
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def _lengths(v: FloatArray) -> FloatArray:
    """(..., 1) of vectors (..., n): to the last bit the same for one and for many."""
    return np.sqrt(np.matmul(v[..., None, :], v[..., :, None])[..., 0])


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
