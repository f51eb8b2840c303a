"""Points from their observations in known poses, batched (docs/slam.md, sec. 5)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shared.geometry import FloatArray
from station.slam.frontend.lens import BoolArray
from station.slam.ukf.measurement import CameraModel

MIN_INVERSE_DEPTH = 1.0 / 200.0
MAX_INVERSE_DEPTH = 1.0 / 0.1


@dataclass(frozen=True, slots=True, eq=False)
class Triangulation:
    p: FloatArray  # (F, 3) world
    is_good: BoolArray  # (F,) in front of every camera that saw it, and the iteration came to rest
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
    R_ia = np.swapaxes(R_wc, 2, 3) @ R_a[:, None]
    t_ia = np.einsum("fmji,fmj->fmi", R_wc, c_a[:, None] - c)
    W = camera.lens.whitening(xy, camera.sigma_px) * seen[..., None, None]

    u = np.empty((F, 3))
    u[:, :2] = xy[pick, last]
    u[:, 2] = _start_inverse_depth(R_ia, t_ia, xy, seen, u[:, :2])
    H = np.zeros((F, 3, 3))
    cost = np.full(F, np.inf)
    damping = np.full(F, 1e-3)
    best = u.copy()
    for _ in range(iterations + 1):
        r, J, _ = _residuals(u, R_ia, t_ia, xy, W)
        new_cost = np.einsum("fmi,fmi->f", r, r)
        better = new_cost <= cost
        best = np.where(better[:, None], u, best)
        cost = np.where(better, new_cost, cost)
        damping = np.where(better, damping * 0.1, damping * 10.0)
        if not better.all():
            r, J, _ = _residuals(best, R_ia, t_ia, xy, W)
        Jf = J.reshape(F, 2 * M, 3)
        H = np.swapaxes(Jf, 1, 2) @ Jf
        g = np.einsum("fki,fk->fi", Jf, r.reshape(F, 2 * M))
        damped = H.copy()
        diagonal = np.arange(3)
        damped[:, diagonal, diagonal] += damping[:, None] * H[:, diagonal, diagonal] + 1e-9
        u = best + np.linalg.solve(damped, g[..., None])[..., 0]
        u[:, 2] = np.clip(u[:, 2], MIN_INVERSE_DEPTH * 0.5, MAX_INVERSE_DEPTH * 2.0)
    u = best
    r, J, depths = _residuals(u, R_ia, t_ia, xy, W)
    count = np.maximum(seen.sum(axis=1), 1)
    rms = np.sqrt(np.einsum("fmi,fmi->f", r, r) / (2.0 * count))
    Jf = J.reshape(F, 2 * M, 3)
    H = np.swapaxes(Jf, 1, 2) @ Jf
    H[:, np.arange(3), np.arange(3)] += 1e-9
    cov_u = np.linalg.inv(H)
    rho = u[:, 2]
    ray = np.column_stack([u[:, :2], np.ones(F)])
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


def _start_inverse_depth(
    R_ia: FloatArray, t_ia: FloatArray, xy: FloatArray, seen: BoolArray, anchor_xy: FloatArray
) -> FloatArray:
    """Inverse depth (F,) along the anchor's ray from linear least squares over all views."""
    ray = np.einsum("fmij,fj->fmi", R_ia, np.column_stack([anchor_xy, np.ones(len(anchor_xy))]))
    # x (ray_z + rho t_z) = ray_x + rho t_x, likewise y
    a = (t_ia[..., :2] - xy * t_ia[..., 2:]) * seen[..., None]
    b = (xy * ray[..., 2:] - ray[..., :2]) * seen[..., None]
    rho = np.einsum("fmi,fmi->f", a, b) / np.maximum(np.einsum("fmi,fmi->f", a, a), 1e-12)
    return np.clip(rho, 0.02, 5.0)


def _residuals(
    u: FloatArray, R_ia: FloatArray, t_ia: FloatArray, xy: FloatArray, W: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Whitened residuals (F, M, 2), Jacobian (F, M, 2, 3) and depth times rho (F, M) at u = (alpha, beta, rho)."""
    ray = np.column_stack([u[:, :2], np.ones(len(u))])
    q = np.einsum("fmij,fj->fmi", R_ia, ray) + u[:, None, 2:] * t_ia
    z = np.where(np.abs(q[..., 2]) < 1e-3, 1e-3, q[..., 2])
    projected = q[..., :2] / z[..., None]
    D = np.zeros((*projected.shape, 3))
    D[..., 0, 0] = D[..., 1, 1] = 1.0 / z
    D[..., 2] = -projected / z[..., None]
    by_u = np.concatenate([R_ia[..., :2], t_ia[..., None]], axis=-1)
    r = (W @ (xy - projected)[..., None])[..., 0]
    return r, W @ D @ by_u, q[..., 2]
