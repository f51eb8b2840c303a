"""Points from observations in known poses, batched.

`triangulate` gives the most likely points with their covariance (docs/slam.md, sec. 5); `intersect_rays` those nearest
to their rays, in one linear step, for tracks of any length.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shared.geometry import FloatArray, IntArray
from station.vision.camera_model import CameraModel
from station.vision.lens import BoolArray

MIN_INVERSE_DEPTH = 1.0 / 200.0
MAX_INVERSE_DEPTH = 1.0 / 0.1
MIN_PARALLAX_RAD = 0.004  # of intersect_rays
MIN_DEPTH_M = 0.05
DONE = 1e-4  # a step that changes no point's squared error by more moves none by a hundredth of its sigma


@dataclass(frozen=True, slots=True, eq=False)
class Triangulation:
    """F points and how well they are known."""

    p: FloatArray  # (F, 3) world
    is_good: BoolArray  # (F,) in front of every camera that saw it, its depth within limits, finite
    depth_sigma: FloatArray  # (F,) relative standard deviation of the depth in the anchor view
    rms: FloatArray  # (F,) whitened reprojection error
    cov: FloatArray  # (F, 3, 3) world, given the poses

    def take(self, keep: BoolArray) -> Triangulation:
        """The points where keep (F,) is True."""
        return Triangulation(self.p[keep], self.is_good[keep], self.depth_sigma[keep], self.rms[keep], self.cov[keep])


def triangulate(
    camera: CameraModel, R_wb: FloatArray, x_wb: FloatArray, xy: FloatArray, seen: BoolArray, iterations: int = 4
) -> Triangulation:
    """Least-squares points by Gauss-Newton in inverse depth, anchored in the last view.

    Args:
        R_wb, x_wb: (F, M, 3, 3), (F, M, 3) body poses of the observations.
        xy: (F, M, 2) normalised observations; seen: (F, M).
    Inverse depth keeps distant points near-linear (Civera et al., IEEE T-RO 24(5), 2008).
    """
    F, M = seen.shape
    R_wc = R_wb @ camera.R_body_cam
    c = x_wb + R_wb @ camera.t_body_cam
    last = M - 1 - np.argmax(seen[:, ::-1], axis=1)
    pick = np.arange(F)
    R_a, c_a = R_wc[pick, last], c[pick, last]
    views = _Views(
        R=np.ascontiguousarray(np.moveaxis(np.swapaxes(R_wc, 2, 3) @ R_a[:, None], (2, 3), (0, 1))),
        t=np.ascontiguousarray(np.moveaxis(((c_a[:, None] - c)[:, :, None] @ R_wc)[:, :, 0], 2, 0)),
        xy=np.ascontiguousarray(np.moveaxis(xy, 2, 0)),
        W=np.ascontiguousarray(np.moveaxis(camera.lens.whitening(xy, camera.sigma_px), (2, 3), (0, 1))) * seen,
    )

    u = np.empty((F, 3))
    u[:, :2] = xy[pick, last]
    u[:, 2] = _start_inverse_depth(views, seen, u[:, :2])
    best, cost, damping = u, np.full(F, np.inf), np.full(F, 1e-3)
    H, g, depths = np.zeros((F, 3, 3)), np.zeros((F, 3)), np.zeros((F, M))
    diagonal = np.arange(3)
    for step in range(iterations + 1):
        new_cost, new_H, new_g, new_depths = _normal_equations(views, u)
        better = new_cost <= cost
        is_done = bool((np.abs(cost - new_cost) < DONE).all())
        if better.all():
            best, cost, H, g, depths = u, new_cost, new_H, new_g, new_depths
        else:
            best, cost = np.where(better[:, None], u, best), np.where(better, new_cost, cost)
            H[better], g[better], depths[better] = new_H[better], new_g[better], new_depths[better]
        if is_done or step == iterations:
            break
        damping = np.where(better, damping * 0.1, damping * 10.0)
        damped = H.copy()
        damped[:, diagonal, diagonal] += damping[:, None] * H[:, diagonal, diagonal] + 1e-9
        u = best + np.linalg.solve(damped, g[..., None])[..., 0]
        u[:, 2] = np.clip(u[:, 2], MIN_INVERSE_DEPTH * 0.5, MAX_INVERSE_DEPTH * 2.0)
    rms = np.sqrt(cost / (2.0 * np.maximum(seen.sum(axis=1), 1)))
    H[:, diagonal, diagonal] += 1e-9
    cov_u = np.linalg.inv(H)
    rho = best[:, 2]
    ray = np.column_stack([best[:, :2], np.ones(F)])
    p = c_a + np.einsum("fij,fj->fi", R_a, ray) / rho[:, None]
    D = np.zeros((F, 3, 3))  # d p / d(alpha, beta, rho), anchor camera axes
    D[:, 0, 0] = D[:, 1, 1] = 1.0 / rho
    D[:, :, 2] = -ray / (rho * rho)[:, None]
    D = R_a @ D
    in_front = np.where(seen, depths > 0.05 * rho[:, None], True).all(axis=1)
    in_range = (rho > MIN_INVERSE_DEPTH) & (rho < MAX_INVERSE_DEPTH)
    return Triangulation(
        p=p,
        is_good=in_front & in_range & np.isfinite(p).all(axis=1),
        depth_sigma=np.sqrt(np.maximum(cov_u[:, 2, 2], 0.0)) / rho,
        rms=rms,
        cov=D @ cov_u @ np.swapaxes(D, 1, 2),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Views:
    """Observations from the anchor's point of view. Components come first: thousands of 3 x 3 products one by one
    cost several times as much as nine sums over long arrays.
    """

    R: FloatArray  # (3, 3, F, M) R_view_anchor
    t: FloatArray  # (3, F, M) of the anchor in the view
    xy: FloatArray  # (2, F, M)
    W: FloatArray  # (2, 2, F, M) whitening; zero where not seen


def _start_inverse_depth(views: _Views, seen: BoolArray, anchor_xy: FloatArray) -> FloatArray:
    """Inverse depth (F,) along the anchor's ray from linear least squares over all views."""
    R, t, xy = views.R, views.t, views.xy
    ray = R[:, 0] * anchor_xy[:, :1] + R[:, 1] * anchor_xy[:, 1:] + R[:, 2]
    # x (ray_z + rho t_z) = ray_x + rho t_x, likewise y
    a = (t[:2] - xy * t[2]) * seen
    b = (xy * ray[2] - ray[:2]) * seen
    rho = np.einsum("ifm,ifm->f", a, b) / np.maximum(np.einsum("ifm,ifm->f", a, a), 1e-12)
    return np.clip(rho, 0.02, 5.0)


def _normal_equations(views: _Views, u: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Squared residuals (F,), J^T J (F, 3, 3), J^T r (F, 3), depth times rho (F, M); u (F, 3): alpha, beta, rho."""
    R, t, W = views.R, views.t, views.W
    F, M = t.shape[1:]
    alpha, beta, rho = u[:, :1], u[:, 1:2], u[:, 2:]
    q = R[:, 0] * alpha + R[:, 1] * beta + R[:, 2] + t * rho
    depth = 1.0 / np.where(np.abs(q[2]) < 1e-3, 1e-3, q[2])
    projected = q[:2] * depth
    # d projected / d(alpha, beta, rho): columns of [R e1, R e2, t] through the projection
    by_u = np.empty((2, 3, F, M))
    by_u[:, :2] = R[:2, :2] - projected[:, None] * R[2, :2]
    by_u[:, 2] = t[:2] - projected * t[2]
    by_u *= depth
    off = views.xy - projected
    r, J = np.empty((F, 2, M)), np.empty((F, 3, 2, M))
    for row in range(2):
        r[:, row] = W[row, 0] * off[0] + W[row, 1] * off[1]
        J[:, :, row] = np.swapaxes(W[row, 0] * by_u[0] + W[row, 1] * by_u[1], 0, 1)
    rows, columns = r.reshape(F, 2 * M), J.reshape(F, 3, 2 * M)
    H = columns @ np.swapaxes(columns, 1, 2)
    return np.einsum("fk,fk->f", rows, rows), H, (columns @ rows[..., None])[..., 0], q[2]


def intersect_rays(
    point: IntArray, num_points: int, centres: FloatArray, rays: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """Points nearest to all their rays, and whether they are well enough defined.

    Args:
        point: (K,) which point each ray belongs to; centres, rays: (K, 3) in the world, rays of length 1.
    Returns:
        (num_points, 3) and (num_points,): False where the rays are nearly parallel or the point lies behind.
    """
    A_each = np.eye(3) - rays[:, :, None] * rays[:, None, :]
    b_each = np.einsum("nij,nj->ni", A_each, centres)
    A = _sums(point, A_each.reshape(-1, 9), num_points).reshape(num_points, 3, 3)
    b = _sums(point, b_each, num_points)
    # The smallest eigenvalue is about the squared parallax: parallel rays leave a direction open.
    count = np.maximum(np.bincount(point, minlength=num_points), 1)
    smallest = np.linalg.eigvalsh(A)[:, 0] / count
    good = smallest > MIN_PARALLAX_RAD**2
    A[~good] = np.eye(3)
    found = np.asarray(np.linalg.solve(A, b[:, :, None])[:, :, 0], dtype=np.float64)
    depth = ((found[point] - centres) * rays).sum(axis=1)
    nearest = np.full(num_points, np.inf)
    np.minimum.at(nearest, point, depth)
    return found, good & (nearest > MIN_DEPTH_M)


def _sums(index: IntArray, values: FloatArray, size: int) -> FloatArray:
    """(size, c) sums of the rows of values (K, c) that share an index."""
    return np.column_stack([np.bincount(index, column, size) for column in values.T])
