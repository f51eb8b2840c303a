"""Exact ray casting of textured rectangles through the lens, row by row, with OpenCV passes over image regions.

Every pixel has its own ray (lens distortion included) turned by the camera's pose at its row's time (rolling shutter).
On a plane, inverse depth along the ray is linear in the ray, so each rectangle costs a few passes over the image
region it can cover; the nearest one wins per pixel. One lookup in the atlas then colours the frame.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from robot.simulation.atlas import NUM_LEVELS, bake_atlas
from robot.simulation.texture_strokes import ImageArray
from robot.simulation.world import Surface, World
from shared.calibration import CameraCalibration
from shared.geometry import FloatArray

Float32Array = npt.NDArray[np.float32]
NEAR_M = 0.02
ANISOTROPY = 0.75  # 0: a texel per lateral footprint (aliases far away), 1: per depth footprint (blurs sideways)
# Corners of a checkerboard then lie within 0.05 px of their place; at -0.35 aliasing moves them 0.2 px.
LEVEL_BIAS = 0.25
NO_SURFACE = 0xFFFF


@dataclass(frozen=True, slots=True, eq=False)
class Rendering:
    """One ideal image with its geometry. The arrays are valid until the next call of render()."""

    image: ImageArray  # (H, W, 3) BGR
    inverse_depth: Float32Array  # (H, W) 1/m along the optical axis, 0 where nothing is seen
    surface: npt.NDArray[np.uint16]  # (H, W) index into Renderer.surfaces, NO_SURFACE where nothing is seen


def unproject_pixels(camera: CameraCalibration) -> Float32Array:
    """Rays (H, 3, W) of all pixels in camera coordinates with z = 1, lens distortion undone exactly."""
    u, v = np.meshgrid(np.arange(camera.width, dtype=np.float64), np.arange(camera.height, dtype=np.float64))
    xy = undistort(camera, np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy], axis=-1))
    rays = np.empty((camera.height, 3, camera.width), np.float32)
    rays[:, 0], rays[:, 1], rays[:, 2] = xy[..., 0], xy[..., 1], 1.0
    return rays


def undistort(camera: CameraCalibration, xy_distorted: FloatArray) -> FloatArray:
    """Ideal normalised coordinates (..., 2) by fixed-point iteration until no bit moves. Source: OpenCV."""
    k = camera.distortion
    if camera.model == "equidistant":
        theta_d = np.linalg.norm(xy_distorted, axis=-1)
        theta = theta_d.copy()
        for _ in range(40):
            t2, before = theta**2, theta
            theta = theta_d / (1 + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3]))))
            if np.array_equal(theta, before):
                break
        return xy_distorted * (np.tan(theta) / np.maximum(theta_d, 1e-12))[..., None]
    xd, yd = xy_distorted.reshape(-1, 2).T.copy()
    x, y = xd, yd
    found, moving = np.empty((2, len(x))), np.arange(len(x))  # the last bit of some moves to and fro for ever
    for _ in range(60):
        r2 = x * x + y * y
        radial = 1 + r2 * (k[0] + r2 * k[1])
        dx = 2 * k[2] * x * y + k[3] * (r2 + 2 * x * x)
        dy = k[2] * (r2 + 2 * y * y) + 2 * k[3] * x * y
        x_before, y_before = x, y
        x, y = (xd - dx) / radial, (yd - dy) / radial
        found[:, moving] = x, y
        moves = (x != x_before) | (y != y_before)
        x, y, xd, yd, moving = x[moves], y[moves], xd[moves], yd[moves], moving[moves]
    return found.T.reshape(xy_distorted.shape)


def poses_by_row(T: FloatArray, height: int) -> tuple[FloatArray, FloatArray]:
    """Rotation (H, 3, 3) and position (H, 3) per row, from poses (K, 4, 4) evenly spaced along them (Lagrange)."""
    rows = np.linspace(0.0, 1.0, height)
    nodes = np.linspace(0.0, 1.0, len(T)) if len(T) > 1 else np.zeros(1)
    weights = np.ones((len(rows), len(T)))
    for k in range(len(T)):
        for j in range(len(T)):
            if j != k:
                weights[:, k] *= (rows - nodes[j]) / (nodes[k] - nodes[j])
    mixed = np.tensordot(weights, T[:, :3, :], axes=1)
    return mixed[:, :, :3], mixed[:, :, 3]


class Renderer:
    """Draws one world through one camera."""

    def __init__(self, world: World, camera: CameraCalibration, cache_dir: Path | None = None) -> None:
        self.camera = camera
        self._rays = unproject_pixels(camera)
        self._column_x = np.stack([self._rays[:, 0].min(axis=0), self._rays[:, 0].max(axis=0)])  # (2, W)
        self._row_y = np.stack([self._rays[:, 1].min(axis=1), self._rays[:, 1].max(axis=1)])  # (2, H)
        shape = (camera.height, camera.width)
        self._world_rays = np.empty_like(self._rays)
        self._inverse_depth = np.empty(shape, np.float32)
        self._u, self._v = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
        self._surface = np.empty(shape, np.uint16)
        self._scratch = [np.empty(shape, np.float32) for _ in range(4)]
        self._id_scratch = np.empty(shape, np.uint16)
        self._row_scratch = [np.empty(shape, np.intp) for _ in range(2)]
        self._surfaces = surfaces = world.surfaces_at(0.0)
        atlas = bake_atlas([s.texture for s in surfaces], cache_dir)
        self.world = world
        self._atlas_image = atlas.image
        self._corners = np.stack([s.corners() for s in surfaces])  # (N, 4, 3)
        self._normals = np.stack([s.normal for s in surfaces])
        self._is_level = np.array([abs(s.ev[2]) < 0.5 for s in surfaces])
        texture = np.array([atlas.index[s.texture] for s in surfaces])
        density = atlas.texels_per_m[texture]  # (N, L)
        offset_m = np.array([[s.u0_m, s.v0_m] for s in surfaces], dtype=np.float32)
        origin = atlas.origin_px[texture] + offset_m[:, None, :] * density[:, :, None]
        # Left, top and density of each surface's levels. The last ones stand for "nothing seen": a corner texel.
        self._table = np.zeros((3, (len(surfaces) + 1) * NUM_LEVELS), np.float32)
        self._table[0:2, : len(surfaces) * NUM_LEVELS] = origin.reshape(-1, 2).T
        self._table[2, : len(surfaces) * NUM_LEVELS] = density.reshape(-1)
        self._log2_density = np.log2(density[:, 0])

    @property
    def surfaces(self) -> list[Surface]:
        """All surfaces as they were drawn last; Rendering.surface counts in them."""
        return self._surfaces

    def render(self, T_world_cam_rows: FloatArray, t_s: float = 0.0) -> Rendering:
        """Draw the world.

        Args:
            T_world_cam_rows: (K, 4, 4) camera poses at evenly spaced rows from the first to the last, K = 1 for a
                global shutter, K = 3 for a rolling one.
            t_s: when, for the persons who walk.
        """
        self._move_walkers(t_s)
        R_rows, t_rows = poses_by_row(np.asarray(T_world_cam_rows, dtype=np.float64), self.camera.height)
        np.matmul(R_rows.astype(np.float32), self._rays, out=self._world_rays)
        self._inverse_depth.fill(0.0)
        self._surface.fill(NO_SURFACE)
        level_constant = np.zeros(len(self._corners) + 1, np.float32)
        camera_poses = np.asarray(T_world_cam_rows)
        for index, region, nearest in self._visible(camera_poses):
            self._draw(index, region, nearest, t_rows, level_constant)
        return Rendering(self._colour(level_constant), self._inverse_depth, self._surface)

    def _move_walkers(self, t_s: float) -> None:
        if not self.world.walkers:
            return
        first = len(self.world.surfaces)
        self._surfaces = self.world.surfaces_at(t_s)
        for index, surface in enumerate(self._surfaces[first:], first):
            self._corners[index], self._normals[index] = surface.corners(), surface.normal

    # --- geometry -------------------------------------------------------------------------------------------------

    def _visible(self, T_rows: FloatArray) -> list[tuple[int, tuple[slice, slice], float]]:
        """Surfaces that may be seen, near ones first: index, image region, greatest inverse depth."""
        x_max, y_max = float(np.abs(self._column_x).max()) + 0.01, float(np.abs(self._row_y).max()) + 0.01
        ends = T_rows[[0, -1]] if len(T_rows) > 1 else T_rows
        p_cams = [(self._corners - T[:3, 3]) @ T[:3, :3] for T in ends]
        p = p_cams[0]
        centre = T_rows[len(T_rows) // 2][:3, 3]
        facing = np.einsum("ni,ni->n", self._normals, centre - self._corners[:, 0]) > 1e-4
        z = p[:, :, 2]
        margin = 0.05  # m: the camera moves during the frame
        outside = (z < NEAR_M).all(1)
        for axis, limit in ((0, x_max), (1, y_max)):
            outside |= (p[:, :, axis] > limit * z + margin).all(1) | (p[:, :, axis] < -limit * z - margin).all(1)
        candidates = np.nonzero(facing & ~outside)[0]
        found = []
        for index in candidates:
            clipped = [_clipped_box(p_cam[index], x_max, y_max) for p_cam in p_cams]
            boxes = [b for b in clipped if b is not None]
            if not boxes:
                continue
            low, high = np.min([b[0] for b in boxes], axis=0), np.max([b[1] for b in boxes], axis=0)
            region = self._region(low, high)
            if region is not None:
                found.append((int(index), region, float(high[2]) * 1.001 + 1e-3))
        found.sort(key=lambda f: -f[2])
        return found

    def _region(self, low: FloatArray, high: FloatArray) -> tuple[slice, slice] | None:
        """Image region that can show normalised coordinates of the box low..high."""
        columns = np.nonzero((self._column_x[1] >= low[0]) & (self._column_x[0] <= high[0]))[0]
        rows = np.nonzero((self._row_y[1] >= low[1]) & (self._row_y[0] <= high[1]))[0]
        if len(columns) == 0 or len(rows) == 0:
            return None
        r0, r1 = max(int(rows[0]) - 2, 0), min(int(rows[-1]) + 3, self.camera.height)
        c0, c1 = max(int(columns[0]) - 2, 0), min(int(columns[-1]) + 3, self.camera.width)
        return slice(r0, r1), slice(c0, c1)

    def _draw(
        self,
        index: int,
        region: tuple[slice, slice],
        nearest: float,
        t_rows: FloatArray,
        level_constant: Float32Array,
    ) -> None:
        """Depth-test one rectangle in its region and note where on it the rays hit."""
        inverse_depth = self._inverse_depth[region]
        if cv2.minMaxLoc(inverse_depth)[0] > nearest:
            return  # all of it is hidden
        surface = self._surfaces[index]
        rows, columns = region
        dx, dy, dz = (self._world_rays[rows, k, columns] for k in range(3))
        w, u, v, spare = (s[region] for s in self._scratch)
        to_origin = np.array(surface.origin) - t_rows[rows]  # (h, 3)
        distance = to_origin @ self._normals[index]  # (h,) m, negative in front
        per_row = (1.0 / distance).astype(np.float32)[:, None]
        eu, ev = surface.eu, surface.ev
        if self._is_level[index]:
            np.multiply(dz, per_row * np.float32(self._normals[index, 2]), out=w)
            cv2.addWeighted(dx, ev[0], dy, ev[1], 0.0, dst=v)
        else:
            cv2.addWeighted(dx, float(self._normals[index, 0]), dy, float(self._normals[index, 1]), 0.0, dst=spare)
            np.multiply(spare, per_row, out=w)
            np.multiply(dz, np.float32(ev[2]), out=v)
        cv2.addWeighted(dx, eu[0], dy, eu[1], 0.0, dst=u)
        cv2.divide(u, w, dst=u)
        cv2.divide(v, w, dst=v)
        np.subtract(u, (to_origin @ np.array(eu)).astype(np.float32)[:, None], out=u)
        np.subtract(v, (to_origin @ np.array(ev)).astype(np.float32)[:, None], out=v)
        mask = cv2.compare(w, inverse_depth, cv2.CMP_GT)
        cv2.bitwise_and(mask, cv2.inRange(u, 0.0, surface.width_m), dst=mask)
        cv2.bitwise_and(mask, cv2.inRange(v, 0.0, surface.height_m), dst=mask)
        if cv2.hasNonZero(mask):
            cv2.copyTo(w, mask, inverse_depth)
            cv2.copyTo(u, mask, self._u[region])
            cv2.copyTo(v, mask, self._v[region])
            ids = self._id_scratch[region]
            ids.fill(index)
            cv2.copyTo(ids, mask, self._surface[region])
            # Footprint of a pixel: 1/(w f) across, 1/(w^2 f d) in depth for a plane at distance d.
            d = max(1e-3, float(-distance.mean()))
            level_constant[index] = (
                self._log2_density[index] - np.log2(self.camera.fx) - ANISOTROPY * np.log2(d) + LEVEL_BIAS
            )

    # --- colour ---------------------------------------------------------------------------------------------------

    def _colour(self, level_constant: Float32Array) -> ImageArray:
        """Look up each pixel's texel at the level whose texels match the pixel's footprint."""
        level, scratch, map_x, map_y = self._scratch
        row, chosen = self._row_scratch
        np.minimum(self._surface, np.uint16(len(self._corners)), out=row)
        np.maximum(self._inverse_depth, np.float32(1e-3), out=scratch)
        cv2.log(scratch, dst=scratch)
        np.take(level_constant, row, out=level, mode="clip")
        cv2.addWeighted(scratch, -(1.0 + ANISOTROPY) / np.log(2.0), level, 1.0, 0.0, dst=level)
        np.rint(level, out=level)
        np.copyto(chosen, np.clip(level, 0, NUM_LEVELS - 1, out=level), casting="unsafe")
        row *= NUM_LEVELS
        row += chosen
        left, top, density = self._table
        np.take(density, row, out=scratch, mode="clip")
        np.take(left, row, out=map_x, mode="clip")
        np.take(top, row, out=map_y, mode="clip")
        cv2.add(cv2.multiply(self._u, scratch, dst=level), map_x, dst=map_x)
        cv2.add(cv2.multiply(self._v, scratch, dst=level), map_y, dst=map_y)
        return np.asarray(cv2.remap(self._atlas_image, map_x, map_y, cv2.INTER_LINEAR), dtype=np.uint8)


def _clipped_box(p_cam: FloatArray, x_max: float, y_max: float) -> tuple[FloatArray, FloatArray] | None:
    """Bounds (x/z, y/z, 1/z) of a polygon (4, 3) inside the viewing pyramid, None when all of it is outside."""
    z = p_cam[:, 2]
    if z.min() > NEAR_M:
        q = np.column_stack([p_cam[:, :2] / z[:, None], 1.0 / z])
        low, high = q.min(axis=0), q.max(axis=0)
        if low[0] >= -x_max and high[0] <= x_max and low[1] >= -y_max and high[1] <= y_max:
            return low, high
    polygon = list(p_cam)
    for plane in ((0.0, 0.0, 1.0), (1.0, 0.0, x_max), (-1.0, 0.0, x_max), (0.0, 1.0, y_max), (0.0, -1.0, y_max)):
        limit = NEAR_M if plane[0] == plane[1] == 0.0 else 0.0
        polygon = _clip(polygon, np.array(plane), limit)
        if not polygon:
            return None
    points = np.array(polygon)
    q = np.column_stack([points[:, :2] / points[:, 2:], 1.0 / points[:, 2]])
    return q.min(axis=0), q.max(axis=0)


def _clip(polygon: list[FloatArray], plane: FloatArray, limit: float) -> list[FloatArray]:
    """The part of a polygon where plane . p >= limit. Source: Sutherland and Hodgman, CACM 17(1), 1974."""
    kept = []
    values = [float(plane @ p) - limit for p in polygon]
    for i, (p, value) in enumerate(zip(polygon, values, strict=True)):
        before, value_before = polygon[i - 1], values[i - 1]
        if (value >= 0) != (value_before >= 0):
            kept.append(before + (p - before) * (value_before / (value_before - value)))
        if value >= 0:
            kept.append(p)
    return kept
