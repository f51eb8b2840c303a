"""Exact ray casting of textured rectangles through the lens, row by row, with OpenCV passes over image regions.

Every pixel has its own ray (lens distortion included) turned by the camera's pose at its row's time (rolling shutter).
On a plane, inverse depth along the ray is linear in the ray, so each rectangle costs a few passes over the image
region it can cover; the nearest one wins per pixel. One lookup in the atlas then colours the frame.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TypeVar

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
SURELY_M = 1e-9  # beyond a plane by more than any rounding
SMALLER = 0.9  # of a region: worth to cut it


@dataclass(frozen=True, slots=True, eq=False)
class Rendering:
    """One ideal image with its geometry. The arrays are valid until the next call of render()."""

    image: ImageArray  # (H, W, 3) BGR
    inverse_depth: Float32Array  # (H, W) 1/m along the optical axis, 0 where nothing is seen
    surface: npt.NDArray[np.uint16]  # (H, W) index into Renderer.surfaces, NO_SURFACE where nothing is seen


@lru_cache(maxsize=2)  # an eighth of a second, nearly all that a second renderer of the same camera would cost
def unproject_pixels(camera: CameraCalibration) -> Float32Array:
    """Rays (H, 3, W) of all pixels in camera coordinates with z = 1, lens distortion undone exactly."""
    u, v = np.meshgrid(np.arange(camera.width, dtype=np.float64), np.arange(camera.height, dtype=np.float64))
    xy = undistort(camera, np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy], axis=-1))
    rays = np.empty((camera.height, 3, camera.width), np.float32)
    rays[:, 0], rays[:, 1], rays[:, 2] = xy[..., 0], xy[..., 1], 1.0
    rays.setflags(write=False)  # all who ask share it
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
        self._pyramid = _Pyramid(float(np.abs(self._column_x).max()) + 0.01, float(np.abs(self._row_y).max()) + 0.01)
        shape = (camera.height, camera.width)
        self._world_rays = np.empty_like(self._rays)
        self._inverse_depth = np.empty(shape, np.float32)
        self._u, self._v = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
        self._surface = np.empty(shape, np.uint16)
        self._scratch = [np.empty(shape, np.float32) for _ in range(4)]
        self._mask_scratch = [np.empty(shape, np.bool_) for _ in range(2)]
        self._id_scratch = np.empty(shape, np.uint16)
        self._entry_scratch = [np.empty(shape, np.uint16) for _ in range(2)]
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
        assert len(surfaces) <= NO_SURFACE // NUM_LEVELS
        self._table = np.zeros((3, 1 << 16), np.float32)
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
        level_constant = np.zeros(1 << 16, np.float32)
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
        x_max, y_max = self._pyramid.x_max, self._pyramid.y_max
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
        boxes = [self._pyramid.boxes(p_cam[candidates]) for p_cam in p_cams]
        low, high = np.min([b[0] for b in boxes], axis=0), np.max([b[1] for b in boxes], axis=0)
        rows = _spans(self._row_y, low[:, 1], high[:, 1], self.camera.height)
        columns = _spans(self._column_x, low[:, 0], high[:, 0], self.camera.width)
        found = [
            (index, (slice(*row), slice(*column)), nearest * 1.001 + 1e-3)
            for index, row, column, nearest in zip(candidates.tolist(), rows, columns, high[:, 2].tolist(), strict=True)
            if row[0] < row[1] and column[0] < column[1]
        ]
        found.sort(key=lambda f: -f[2])
        return found

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
        shape = dx.shape
        w, mask = _start_of(self._scratch[0], shape), _start_of(self._mask_scratch[0], shape)
        to_origin = np.array(surface.origin) - t_rows[rows]  # (h, 3)
        distance = to_origin @ self._normals[index]  # (h,) m, negative in front
        per_row = (1.0 / distance).astype(np.float32)[:, None]
        if self._is_level[index]:
            np.multiply(dz, per_row * np.float32(self._normals[index, 2]), out=w)
        else:
            cv2.addWeighted(dx, float(self._normals[index, 0]), dy, float(self._normals[index, 1]), 0.0, dst=w)
            np.multiply(w, per_row, out=w)
        np.greater(w, inverse_depth, out=mask)
        # What lies behind something nearer is most of it: the rest of the work is for the box around what is left.
        left, top, width, height = cv2.boundingRect(mask.view(np.uint8))
        if not width:
            return
        if width * height < SMALLER * mask.size:
            inside = slice(top, top + height), slice(left, left + width)
            rows = slice(rows.start + top, rows.start + top + height)
            columns = slice(columns.start + left, columns.start + left + width)
            region = rows, columns
            inverse_depth, to_origin = self._inverse_depth[region], to_origin[inside[0]]
            dx, dy, dz, w, mask = dx[inside], dy[inside], dz[inside], w[inside], mask[inside]
            shape = dx.shape
        u, v = (_start_of(s, shape) for s in self._scratch[1:3])
        other = _start_of(self._mask_scratch[1], shape)
        eu, ev = surface.eu, surface.ev
        if self._is_level[index]:
            cv2.addWeighted(dx, ev[0], dy, ev[1], 0.0, dst=v)
        else:
            np.multiply(dz, np.float32(ev[2]), out=v)
        cv2.addWeighted(dx, eu[0], dy, eu[1], 0.0, dst=u)
        for along, axis, length_m in ((u, eu, surface.width_m), (v, ev, surface.height_m)):
            cv2.divide(along, w, dst=along)
            np.subtract(along, (to_origin @ np.array(axis)).astype(np.float32)[:, None], out=along)
            mask &= np.greater_equal(along, np.float32(0.0), out=other)
            mask &= np.less_equal(along, np.float32(length_m), out=other)
        seen = mask.view(np.uint8)
        if cv2.hasNonZero(seen):
            cv2.copyTo(w, seen, inverse_depth)
            cv2.copyTo(u, seen, self._u[region])
            cv2.copyTo(v, seen, self._v[region])
            ids = _start_of(self._id_scratch, shape)
            ids.fill(index)
            cv2.copyTo(ids, seen, self._surface[region])
            # Footprint of a pixel: 1/(w f) across, 1/(w^2 f d) in depth for a plane at distance d.
            d = max(1e-3, float(-distance.mean()))
            level_constant[index] = (
                self._log2_density[index] - np.log2(self.camera.fx) - ANISOTROPY * np.log2(d) + LEVEL_BIAS
            )

    # --- colour ---------------------------------------------------------------------------------------------------

    def _colour(self, level_constant: Float32Array) -> ImageArray:
        """Look up each pixel's texel at the level whose texels match the pixel's footprint."""
        level, scratch, map_x, map_y = self._scratch
        np.maximum(self._inverse_depth, np.float32(1e-3), out=scratch)
        cv2.log(scratch, dst=scratch)
        cv2.LUT(self._surface, level_constant[None], dst=level)
        cv2.addWeighted(scratch, -(1.0 + ANISOTROPY) / np.log(2.0), level, 1.0, 0.0, dst=level)
        np.rint(level, out=level)
        entry, chosen = self._entry_scratch
        np.copyto(chosen, np.clip(level, 0, NUM_LEVELS - 1, out=level), casting="unsafe")
        np.multiply(self._surface, np.uint16(NUM_LEVELS), out=entry)  # NO_SURFACE overflows into the table's last ones
        entry += chosen
        left, top, density = self._table[:, None]
        cv2.LUT(entry, density, dst=scratch)
        cv2.LUT(entry, left, dst=map_x)
        cv2.LUT(entry, top, dst=map_y)
        cv2.add(cv2.multiply(self._u, scratch, dst=level), map_x, dst=map_x)
        cv2.add(cv2.multiply(self._v, scratch, dst=level), map_y, dst=map_y)
        return np.asarray(cv2.remap(self._atlas_image, map_x, map_y, cv2.INTER_LINEAR), dtype=np.uint8)


ArrayT = TypeVar("ArrayT", bound=np.generic)


def _start_of(scratch: npt.NDArray[ArrayT], shape: tuple[int, ...]) -> npt.NDArray[ArrayT]:
    """An array of that shape in the scratch's first bytes: close together, they stay in the processor's cache."""
    return scratch.reshape(-1)[: shape[0] * shape[1]].reshape(shape)


def _spans(bounds: Float32Array, low: FloatArray, high: FloatArray, size: int) -> list[tuple[int, int]]:
    """First and last + 1 of the image's columns (or rows) that can show low..high (N,), and two more on each side.

    `bounds`: (2, size) least and greatest normalised coordinate in each column. Empty: none can.
    """
    can = (bounds[1] >= low[:, None]) & (bounds[0] <= high[:, None])
    first, last = can.argmax(axis=1), size - 1 - can[:, ::-1].argmax(axis=1)
    return [
        (max(f - 2, 0), min(e + 3, size)) if any_can else (0, 0)
        for f, e, any_can in zip(first.tolist(), last.tolist(), can.any(axis=1).tolist(), strict=True)
    ]


Point = tuple[float, float, float]


class _Pyramid:
    """What a camera sees: x/z within x_max, y/z within y_max, z from NEAR_M on."""

    def __init__(self, x_max: float, y_max: float) -> None:
        self.x_max, self.y_max = x_max, y_max
        self._planes = np.array(
            [(0.0, 0.0, 1.0), (1.0, 0.0, x_max), (-1.0, 0.0, x_max), (0.0, 1.0, y_max), (0.0, -1.0, y_max)]
        )

    def boxes(self, p_cam: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Bounds (N, 3) of x/z, y/z, 1/z of polygons (N, 4, 3) inside the pyramid; infinite where all is outside."""
        z = p_cam[:, :, 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            q = np.concatenate([p_cam[:, :, :2] / z[..., None], 1.0 / z[..., None]], axis=-1)
        low, high = q.min(axis=1), q.max(axis=1)
        limit = np.array([self.x_max, self.y_max])
        whole = (z.min(axis=1) > NEAR_M) & (low[:, :2] >= -limit).all(1) & (high[:, :2] <= limit).all(1)
        values = _dots(p_cam[:, None], self._planes[None, :, None])  # (N, 5, 4)
        values[:, 0] -= NEAR_M
        least, greatest = values.min(axis=2), values.max(axis=2)
        for k in np.nonzero(~whole)[0].tolist():
            polygon: list[Point] = []
            if (greatest[k] > -SURELY_M).all():
                polygon = [(x, y, z) for x, y, z in p_cam[k].tolist()]
            # What is cut off by one plane leaves nothing beyond another that was not there before.
            for plane in np.nonzero(least[k] < SURELY_M)[0].tolist() if polygon else ():
                polygon = _clip(polygon, self._planes[plane], NEAR_M if plane == 0 else 0.0)
                if not polygon:
                    break
            if polygon:
                points = [(x / z, y / z, 1.0 / z) for x, y, z in polygon]
                low[k], high[k] = tuple(map(min, *points)), tuple(map(max, *points))
            else:
                low[k], high[k] = np.inf, -np.inf
        return low, high


def _dots(a: FloatArray, b: FloatArray) -> FloatArray:
    """Scalar products (...) of vectors (..., 3), to the last bit those of single pairs."""
    return np.matmul(a[..., None, :], b[..., None])[..., 0, 0]


def _clip(polygon: list[Point], plane: FloatArray, limit: float) -> list[Point]:
    """The part of a polygon where plane . p >= limit. Source: Sutherland and Hodgman, CACM 17(1), 1974."""
    kept: list[Point] = []
    values = (_dots(np.array(polygon), plane) - limit).tolist()
    for i, (p, value) in enumerate(zip(polygon, values, strict=True)):
        before, value_before = polygon[i - 1], values[i - 1]
        if (value >= 0) != (value_before >= 0):
            share = value_before / (value_before - value)
            (x, y, z), (x0, y0, z0) = p, before
            kept.append((x0 + (x - x0) * share, y0 + (y - y0) * share, z0 + (z - z0) * share))
        if value >= 0:
            kept.append(p)
    return kept
