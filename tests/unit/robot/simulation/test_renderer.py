"""The picture shows things where the calibration says they are."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest

import robot.simulation.renderer as renderer_module
from robot.simulation.atlas import bake_atlas
from robot.simulation.config import SimulationConfig
from robot.simulation.renderer import NO_SURFACE, Renderer, undistort
from robot.simulation.textures import Glow, TextureSpec
from robot.simulation.worlds import make_world
from shared.calibration import REFERENCE_CAMERA, CameraCalibration
from shared.geometry import FloatArray, inverse, transform

FISHEYE = CameraCalibration(
    width=640,
    height=480,
    fx=380.0,
    fy=378.0,
    cx=322.0,
    cy=236.0,
    model="equidistant",
    distortion=(0.01, -0.004, 0.002, -0.0005),
)
EUROC = CameraCalibration(
    width=752,
    height=480,
    fx=458.654,
    fy=457.296,
    cx=367.215,
    cy=248.375,
    distortion=(-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05),
)
SMALL_CAMERA = CameraCalibration(
    width=210, height=160, fx=150.0, fy=150.0, cx=105.0, cy=80.0, distortion=(-0.28, 0.07, 0.0002, 0.00002)
)
CAMERAS = {"reference": REFERENCE_CAMERA, "euroc": EUROC, "fisheye": FISHEYE}


def project_points(camera: CameraCalibration, p_cam: FloatArray) -> FloatArray:
    """Pixels (N, 2) of points (N, 3) m in camera coordinates, all in front of the camera."""
    zero = np.zeros(3)
    coefficients = np.array(camera.distortion)
    if camera.model == "equidistant":
        uv, _ = cv2.fisheye.projectPoints(p_cam[:, None, :], zero, zero, camera.K, coefficients)
    else:
        uv, _ = cv2.projectPoints(p_cam[:, None, :], zero, zero, camera.K, coefficients)
    return np.asarray(uv, dtype=np.float64).reshape(-1, 2)


def look_at_pose(camera_position: Sequence[float], yaw_rad: float, pitch_rad: float = 0.0) -> FloatArray:
    """T_world_cam (4, 4) of a level camera that looks along yaw, tilted up by pitch."""
    c, s, cp, sp = np.cos(yaw_rad), np.sin(yaw_rad), np.cos(pitch_rad), np.sin(pitch_rad)
    forward = np.array([c * cp, s * cp, sp])
    right = np.array([s, -c, 0.0])
    T = np.eye(4)
    T[:3, :3] = np.column_stack([right, np.cross(forward, right), forward])
    T[:3, 3] = camera_position
    return T


def checker_corners_on_wall() -> FloatArray:
    """Inner corners (N, 3) of the 0.1 m squares on the wall x = 4 of the checker world."""
    y, z = np.meshgrid(np.arange(0.5, 3.5, 0.1), np.arange(0.1, 2.4, 0.1))
    return np.column_stack([np.full(y.size, 4.0), y.ravel(), z.ravel()])


def visible_pixels(camera: CameraCalibration, T_world_cam: FloatArray, p_world: FloatArray) -> FloatArray:
    p_cam = transform(inverse(T_world_cam), p_world)
    p_cam = p_cam[(p_cam[:, 2] > 0.1) & (np.hypot(p_cam[:, 0], p_cam[:, 1]) < 0.9 * p_cam[:, 2])]
    uv = project_points(camera, p_cam)
    inside = (uv > 12).all(1) & (uv[:, 0] < camera.width - 13) & (uv[:, 1] < camera.height - 13)
    return np.asarray(uv[inside])


@pytest.mark.parametrize("name", CAMERAS)
def test_texture_corners_appear_where_the_camera_model_projects_them(name: str) -> None:
    camera = CAMERAS[name]
    renderer = Renderer(make_world("checker", 0), camera)
    T = look_at_pose((1.9, 1.2, 1.1), np.radians(8), np.radians(-3))
    grey = cv2.cvtColor(renderer.render(T[None]).image, cv2.COLOR_BGR2GRAY)
    expected = visible_pixels(camera, T, checker_corners_on_wall())
    assert len(expected) > 20
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 40, 1e-4)
    found = cv2.cornerSubPix(grey, np.ascontiguousarray(expected[:, None], np.float32), (4, 4), (-1, -1), criteria)[
        :, 0
    ]
    error = np.hypot(*(found - expected).T)
    assert np.median(error) < 0.1
    assert np.abs((found - expected)[error < 0.5].mean(0)).max() < 0.03  # no shift of the whole picture
    # The cube hides some corners: there the refinement runs elsewhere.
    assert np.mean(error < 0.2) > 0.85


def test_depth_and_surface_are_those_of_the_ray() -> None:
    world = make_world("checker", 0)
    renderer = Renderer(world, EUROC)
    T = look_at_pose((1.0, 1.5, 0.8), 0.3, -0.1)
    rendering = renderer.render(T[None])
    rng = np.random.default_rng(0)
    for v, u in rng.integers([0, 0], [480, 752], (60, 2)):
        xy = undistort(EUROC, np.array([(u - EUROC.cx) / EUROC.fx, (v - EUROC.cy) / EUROC.fy]))
        ray = T[:3, :3] @ np.array([*xy, 1.0])
        depth, index = nearest_hit(world, T[:3, 3], ray)
        if index is None:
            assert rendering.surface[v, u] == NO_SURFACE
        elif rendering.surface[v, u] == index:
            assert 1.0 / rendering.inverse_depth[v, u] == pytest.approx(depth, rel=1e-4)
        else:  # an edge between two surfaces may fall to either side of the pixel's centre
            assert 1.0 / rendering.inverse_depth[v, u] == pytest.approx(depth, rel=1e-3)


def nearest_hit(world: object, origin: FloatArray, ray: FloatArray) -> tuple[float, int | None]:
    """Depth along the ray and index of the first surface, by plain geometry."""
    best: tuple[float, int | None] = (np.inf, None)
    for index, surface in enumerate(make_world("checker", 0).surfaces):
        facing = surface.normal @ ray
        if facing >= 0:
            continue
        t = surface.normal @ (np.array(surface.origin) - origin) / facing
        local = origin + t * ray - np.array(surface.origin)
        u, v = local @ np.array(surface.eu), local @ np.array(surface.ev)
        if 0 < t < best[0] and 0 <= u <= surface.width_m and 0 <= v <= surface.height_m:
            best = (float(t), index)
    return best


def test_rolling_shutter_rows_equal_the_rows_of_still_pictures() -> None:
    renderer = Renderer(make_world("checker", 0), REFERENCE_CAMERA)
    poses = np.stack([look_at_pose((1.9 + 0.003 * k, 1.2, 1.1), 0.1 + 0.01 * k) for k in range(3)])
    rolling = renderer.render(poses).image.copy()
    first, middle, last = (renderer.render(T[None]).image.copy() for T in poses)
    middle_row = (REFERENCE_CAMERA.height - 1) / 2
    assert np.abs(rolling[0].astype(int) - first[0]).max() <= 2
    assert np.abs(rolling[-1].astype(int) - last[-1]).max() <= 2
    near = rolling[int(middle_row)].astype(int) - middle[int(middle_row)]
    assert np.mean(np.abs(near) <= 12) > 0.97  # the middle pose lies half a row further
    assert np.abs(rolling[0].astype(int) - last[0]).max() > 50


class Uncut(Renderer):
    """Asks every pixel about every surface, in the same order."""

    def _visible(self, T_rows: FloatArray) -> list[tuple[int, tuple[slice, slice], float]]:
        seen = [index for index, _, _ in super()._visible(T_rows)]
        everything = slice(0, self.camera.height), slice(0, self.camera.width)
        behind = [k for k in range(len(self.surfaces)) if k not in seen and self._faces(k, T_rows)]
        return [(index, everything, np.inf) for index in [*seen, *behind]]

    def _faces(self, index: int, T_rows: FloatArray) -> bool:
        return bool(self._normals[index] @ (T_rows[len(T_rows) // 2, :3, 3] - self._corners[index, 0]) > 1e-4)


@pytest.mark.parametrize(("name", "seed"), [("small", 2), ("plain", 3), ("checker", 0)])
def test_what_is_left_out_as_unseen_changes_no_bit(
    name: str, seed: int, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    world = make_world(name, seed, SimulationConfig(walkers=1))
    quick, plain = Renderer(world, SMALL_CAMERA, tmp_path), Uncut(world, SMALL_CAMERA, tmp_path)
    rng = np.random.default_rng(seed)
    for number in range(12):
        room = world.rooms[number % len(world.rooms)]
        T = look_at_pose((*room.centre, float(rng.uniform(0.1, 0.6))), *rng.uniform([0, -0.6], [6.3, 0.6]))
        moved = T.copy()
        moved[:3, 3] += rng.normal(0, 0.005, 3)
        poses = np.stack([T, 0.5 * (T + moved), moved]) if number % 2 else T[None]
        drawn = quick.render(poses, float(number))
        with monkeypatch.context() as patched:
            patched.setattr(renderer_module, "SMALLER", 0.0)
            expected = plain.render(poses, float(number))
        assert (drawn.surface == expected.surface).all()
        assert (drawn.inverse_depth == expected.inverse_depth).all()
        # How fine a texture is looked up hangs on the mean distance of the rows asked.
        assert np.mean(drawn.image == expected.image) > 0.98


def test_same_seed_same_picture_other_seed_another() -> None:
    pictures = []
    for seed in (1, 1, 2):
        world = make_world("room", seed)
        T = look_at_pose((*world.rooms[0].centre, 0.25), 0.7)
        pictures.append(Renderer(world, EUROC).render(T[None]).image.copy())
    assert (pictures[0] == pictures[1]).all()
    assert (pictures[0] != pictures[2]).mean() > 0.3


def test_where_a_texture_lies_does_not_depend_on_the_process() -> None:
    """A set's order changes with every process; it decided between textures that differ in their light alone."""
    lit = [TextureSpec("lacquer", 3, 0.1, 0.1, 100, glows=(Glow(0.0, 0.0, 0.1 * k, 0.4),)) for k in range(30)]
    atlas = bake_atlas([*lit, *lit[::-1]], None)
    assert list(atlas.index) == lit


def test_cached_textures_equal_painted_ones_and_a_broken_cache_is_ignored(tmp_path: Path) -> None:
    world = make_world("room", 3)
    T = look_at_pose((*world.rooms[0].centre, 0.25), 0.7)[None]
    painted = Renderer(world, EUROC, tmp_path).render(T).image.copy()
    cached = Renderer(world, EUROC, tmp_path).render(T).image.copy()
    (file,) = tmp_path.glob("*.npy")
    file.write_bytes(file.read_bytes()[:1000])
    repaired = Renderer(world, EUROC, tmp_path).render(T).image.copy()
    assert (painted == cached).all() and (painted == repaired).all()


def test_no_gap_shows_between_the_surfaces_of_a_room() -> None:
    world = make_world("home", 4)
    renderer = Renderer(world, EUROC)
    for room in world.rooms:
        for yaw in np.arange(0.0, 6.0, 1.5):
            surface = renderer.render(look_at_pose((*room.centre, 0.3), yaw)[None]).surface
            assert np.mean(surface == NO_SURFACE) < 1e-4
