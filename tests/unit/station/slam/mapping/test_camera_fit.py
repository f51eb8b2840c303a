"""A map that is held by something else than its camera tells what its camera is."""

from __future__ import annotations

from dataclasses import dataclass, replace

import msgspec
import numpy as np
import pytest
from scipy.sparse import csc_matrix, diags_array

from shared.calibration import REFERENCE_CAMERA, CameraCalibration, ImuNoise
from shared.errors import DegenerateGeometry
from shared.geometry import FloatArray, IntArray, so3_exp, so3_log
from station.model.best_camera import KnownCamera, corrected
from station.model.calibration_fit import FITS, UNKNOWN, judge
from station.motion.preintegration import ImuSegment, preintegrate
from station.slam.mapping.camera_fit import SIZE, TOLD_SIGMA, CameraFit, camera_jacobian, moved
from station.slam.mapping.inertial_terms import InertialTerms
from station.slam.mapping.odometry_bundle import BundleState, Observations, information_on
from station.slam.mapping.rolling_shutter import RowMotion, turned_back
from station.vision.lens import Lens

VIEWS, POINTS = 24, 160
LENS = REFERENCE_CAMERA


@dataclass(frozen=True, slots=True, eq=False)
class HeldPoses:
    """Motion terms of poses that something else knows to so much (rad and m)."""

    R: FloatArray  # (N, 3, 3)
    p: FloatArray  # (N, 3)
    sigma: float

    def _off(self, state: BundleState) -> FloatArray:
        turned = so3_log(np.swapaxes(self.R, 1, 2) @ state.R_world_body)
        return np.hstack([turned, state.p_world_body - self.p]).ravel() / self.sigma

    def cost(self, state: BundleState) -> float:
        return float((self._off(state) ** 2).sum())

    def normal_equations(self, state: BundleState) -> tuple[csc_matrix, FloatArray]:
        size = 6 * len(self.R)
        return csc_matrix(diags_array(np.full(size, self.sigma**-2))), self._off(state) / self.sigma


@dataclass(frozen=True, slots=True, eq=False)
class Drive:
    """A robot that turns before points, photographed by a true camera."""

    state: BundleState
    held: HeldPoses
    uv_px: list[FloatArray]  # of each view
    number: list[IntArray]  # of its points
    rates: list[tuple[FloatArray, FloatArray]]  # of each view: v_body m/s, omega_body rad/s

    def seen_by(self, camera: CameraCalibration, late_s: float) -> tuple[Observations, list[RowMotion]]:
        """As the map has it: rays turned and moved back to the time of the pose."""
        R_cam_body, t = camera.T_body_cam_matrix[:3, :3].T, camera.T_body_cam_matrix[:3, 3]
        xy, rows = [], []
        for k, (uv, number) in enumerate(zip(self.uv_px, self.number, strict=True)):
            v, omega = self.rates[k]
            row = RowMotion(np.full(len(uv), late_s), R_cam_body @ (v + np.cross(omega, t)), R_cam_body @ omega)
            rays = turned_back(Lens(camera).unproject(uv), row.delay_s, row.omega_cam)
            p_body = (self.state.points[number] - self.state.p_world_body[k]) @ self.state.R_world_body[k]
            depth = ((p_body - t) @ R_cam_body.T)[:, 2]
            then = depth - row.v_cam[2] * late_s
            xy.append((rays * then[:, None] + row.v_cam[:2] * late_s) / depth[:, None])
            rows.append(row)
        keyframe = np.repeat(np.arange(VIEWS), [len(n) for n in self.number])
        focal = 0.5 * (camera.fx + camera.fy)
        seen = Observations(
            keyframe, np.concatenate(self.number), np.vstack(xy), camera.T_cam_body_matrix, focal
        )  # fmt: skip
        return seen, rows


def make_drive(seed: int, true: CameraCalibration, late_s: float, noise_px: float, held: float = 1e-4) -> Drive:
    rng = np.random.default_rng(seed)
    yaw = np.linspace(0.0, 1.2, VIEWS) + rng.normal(0, 0.02, VIEWS)
    R = so3_exp(np.column_stack([rng.normal(0, 0.02, (VIEWS, 2)), yaw]))
    p = np.column_stack([0.5 * np.sin(2 * yaw), 0.6 * yaw, rng.normal(0, 0.01, VIEWS)])
    bearing = rng.uniform(-0.3, 1.5, POINTS)
    far = rng.uniform(1.5, 4.0, POINTS)
    points = np.column_stack([far * np.cos(bearing), far * np.sin(bearing), rng.uniform(-0.5, 0.6, POINTS)])
    T = true.T_body_cam_matrix
    uv_px, number, rates = [], [], []
    for k in range(VIEWS):
        v, omega = rng.normal(0, 0.3, 3), rng.normal(0, 0.2, 3) + np.array([0.0, 0.0, rng.choice([-1.0, 1.0])])
        R_then, p_then = R[k] @ so3_exp(omega * late_s), p[k] + R[k] @ v * late_s
        p_cam = ((points - p_then) @ R_then - T[:3, 3]) @ T[:3, :3]
        uv = Lens(true).project(p_cam[:, :2] / p_cam[:, 2:])
        inside = (p_cam[:, 2] > 0.3) & (np.abs(p_cam[:, :2] / p_cam[:, 2:]) < 0.6).all(axis=1)
        inside &= (uv > 0).all(axis=1) & (uv < [true.width, true.height]).all(axis=1)
        uv_px.append(uv[inside] + rng.normal(0, noise_px, (int(inside.sum()), 2)))
        number.append(np.flatnonzero(inside))
        rates.append((v, omega))
    often = np.bincount(np.concatenate(number), minlength=POINTS) >= 2
    new = np.cumsum(often) - 1
    for k in range(VIEWS):
        keep = often[number[k]]
        uv_px[k], number[k] = uv_px[k][keep], new[number[k][keep]]
    return Drive(BundleState(R, p, points[often], np.zeros(0)), HeldPoses(R, p, held), uv_px, number, rates)


def wrong(rng: np.random.Generator) -> FloatArray:
    """What a calibration at home may be off by (8,)."""
    return np.asarray(rng.normal(0, 1, SIZE) * TOLD_SIGMA)


def rounds(drive: Drive, fit: CameraFit, count: int) -> CameraFit:
    for _ in range(count):
        seen, rows = drive.seen_by(fit.camera, fit.late_s)
        fit = fit.improved(drive.state, seen, drive.held, rows, 50.0)
    return fit


def told(error: FloatArray) -> CameraCalibration:
    """Who tells so that `moved(told, error)` is the true camera; pinhole and mounting invert each other."""
    longer, T = float(np.exp(-error[0])), LENS.T_body_cam_matrix
    T[:3, :3] = T[:3, :3] @ so3_exp(-error[1:4])
    T[:3, 3] -= error[5:]
    return msgspec.structs.replace(LENS, fx=longer * LENS.fx, fy=longer * LENS.fy, T_body_cam=tuple(T.ravel().tolist()))


@pytest.mark.parametrize("seed", range(4))
def test_a_camera_that_tells_wrong_numbers_is_found(seed: int) -> None:
    error = wrong(np.random.default_rng([seed, 5]))
    drive = make_drive(seed, LENS, float(error[4]), 0.0)
    camera = told(error)
    fit = rounds(drive, CameraFit.started(camera, KnownCamera(camera, 0.01)), 4)
    assert fit.sigma is not None
    left = np.abs(fit.error - error)
    assert (left < 2.0 * fit.sigma).all()  # without noise in the pixels: what the prior draws towards what was told
    assert (left[:5] < 0.3 * TOLD_SIGMA[:5]).all()  # where the camera sits on the body matters little, and shows little


def test_its_standard_deviations_are_what_it_is_off_by() -> None:
    off = []
    for seed in range(40):
        error = wrong(np.random.default_rng([seed, 6]))
        drive = make_drive(seed, LENS, float(error[4]), 1.0)  # a pixel, as the adjustment takes it
        camera = told(error)
        fit = rounds(drive, CameraFit.started(camera, KnownCamera(camera, 0.01)), 3)
        assert fit.sigma is not None
        off.append((fit.error - error) / fit.sigma)
    mean_square = np.square(off).mean(axis=0)
    assert (mean_square > 0.45).all() and (mean_square < 1.8).all(), mean_square  # chi-squared of 40, 99.9 %


def test_the_jacobian_is_how_residuals_change() -> None:
    drive = make_drive(1, LENS, 0.0, 0.0)
    seen, rows = drive.seen_by(LENS, 0.0)
    J = camera_jacobian(drive.state, seen, LENS, rows)
    step = np.array([1e-5, *[1e-5] * 3, 1e-5, *[1e-5] * 3])
    for c in range(SIZE):
        error = np.zeros(SIZE)
        error[c] = step[c]
        camera, late_s = moved(LENS, error), float(error[4])
        then, _ = drive.seen_by(camera, late_s)
        before, after = residuals(drive.state, seen), residuals(drive.state, replace(then, focal_px=seen.focal_px))
        numeric = (after - before) / step[c]
        assert np.allclose(J[:, :, c], numeric, rtol=2e-3, atol=2e-3 * np.abs(numeric).max()), c


def residuals(state: BundleState, seen: Observations) -> FloatArray:
    p_body = np.einsum(
        "kji,kj->ki", state.R_world_body[seen.keyframe], state.points[seen.point] - state.p_world_body[seen.keyframe]
    )
    p_cam = p_body @ seen.T_cam_body[:3, :3].T + seen.T_cam_body[:3, 3]
    return np.asarray((p_cam[:, :2] / p_cam[:, 2:] - seen.xy) * seen.focal_px)


def test_information_is_that_of_the_whole_problem_with_all_else_marginalised() -> None:
    drive = make_drive(2, LENS, 0.0, 1.0, held=0.01)
    seen, rows = drive.seen_by(LENS, 0.0)
    J = camera_jacobian(drive.state, seen, LENS, rows)
    matrix, score = information_on(drive.state, seen, drive.held, 1e6, J)
    whole = whole_jacobian(drive.state, seen, J)
    r = residuals(drive.state, seen).ravel()
    H, g = whole.T @ whole, whole.T @ r
    held, of_held = drive.held.normal_equations(drive.state)
    n = held.shape[0]
    H[:n, :n] += held.toarray()
    g[:n] += of_held
    rest, c = slice(0, len(H) - SIZE), slice(len(H) - SIZE, len(H))
    by_rest = np.linalg.solve(H[rest, rest], np.column_stack([H[rest, c], g[rest]]))
    assert np.allclose(matrix, H[c, c] - H[c, rest] @ by_rest[:, :SIZE], rtol=1e-4, atol=1e-4 * np.abs(matrix).max())
    expected = -(g[c] - H[c, rest] @ by_rest[:, SIZE])
    assert np.allclose(score, expected, rtol=1e-3, atol=1e-3 * np.abs(expected).max())


def whole_jacobian(state: BundleState, seen: Observations, J: FloatArray) -> FloatArray:
    """(2K, 6N + 3M + 8) by differences; the camera's columns as given."""
    n, m = len(state.R_world_body), len(state.points)
    columns, step = [], 1e-6
    before = residuals(state, seen)
    for k in range(n):
        for axis in range(6):
            d = np.zeros(6)
            d[axis] = step
            R, p = state.R_world_body.copy(), state.p_world_body.copy()
            R[k], p[k] = R[k] @ so3_exp(d[:3]), p[k] + d[3:]
            columns.append((residuals(replace(state, R_world_body=R, p_world_body=p), seen) - before).ravel() / step)
    for i in range(m):
        for axis in range(3):
            points = state.points.copy()
            points[i, axis] += step
            columns.append((residuals(replace(state, points=points), seen) - before).ravel() / step)
    return np.hstack([np.column_stack(columns), J.reshape(-1, SIZE)])


def test_what_is_known_before_the_map_is_where_it_starts() -> None:
    fit = judge((1.02, 0.003), np.array([0.5, -1.0, 0.1]), np.array([0.2, 0.4, 0.2]), (0.005, 0.001))
    known = corrected(REFERENCE_CAMERA, fit)
    start = CameraFit.started(REFERENCE_CAMERA, known)
    assert start.camera == known.camera and start.late_s == known.late_s == pytest.approx(0.005, rel=0.05)
    again = moved(REFERENCE_CAMERA, start.error)
    assert again.fx == pytest.approx(known.camera.fx, rel=1e-12)
    assert np.allclose(again.T_body_cam_matrix, known.camera.T_body_cam_matrix, atol=1e-12)
    assert start.judged() is None  # no map has said anything


def test_a_right_camera_is_said_to_fit() -> None:
    fit = rounds(make_drive(3, LENS, 0.0, 0.3), CameraFit.started(LENS, KnownCamera(LENS, 0.01)), 2)
    judged = fit.judged()
    assert judged is not None and judged.verdict == FITS
    assert judged.focal_sigma < 0.003


@pytest.mark.parametrize("noise_px", [0.3, 30.0])
def test_what_is_told_counts_once_where_the_fit_corrects_it(noise_px: float) -> None:
    error = wrong(np.random.default_rng(9))
    drive = make_drive(9, LENS, float(error[4]), noise_px)
    camera = told(error)
    fit = rounds(drive, CameraFit.started(camera, KnownCamera(camera, 0.01)), 2)
    assert fit.sigma is not None and (fit.sigma < TOLD_SIGMA).all()
    again = corrected(camera, fit.judged())
    assert again.camera.fx == pytest.approx(fit.camera.fx, rel=1e-9)
    assert np.allclose(again.camera.T_body_cam_matrix[:3, :3], fit.camera.T_body_cam_matrix[:3, :3], atol=1e-9)
    assert again.focal_sigma == pytest.approx(fit.sigma[0]) and again.late_s == pytest.approx(fit.late_s)


def test_a_map_that_knows_no_more_than_was_told_is_not_said_to_fit() -> None:
    sigma = TOLD_SIGMA / np.sqrt(2.0)
    half_of_four_per_cent = np.array([0.02, *np.zeros(7)])
    fit = CameraFit(LENS, moved(LENS, half_of_four_per_cent), half_of_four_per_cent, 0.01, sigma).judged()
    assert fit is not None and fit.verdict == UNKNOWN
    assert np.log(fit.focal_scale) == pytest.approx(0.04) and fit.focal_sigma == pytest.approx(0.01)


def test_a_map_that_says_nothing_leaves_all_open() -> None:
    fit = CameraFit(LENS, LENS, np.zeros(SIZE), 0.01, TOLD_SIGMA).judged()
    assert fit is not None and fit.verdict == UNKNOWN
    assert fit.focal_scale == 1.0 and fit.focal_sigma == pytest.approx(0.1)


def test_a_map_that_knows_the_camera_worse_than_the_drive_before_it_leaves_it() -> None:
    drive = make_drive(4, LENS, 0.0, 30.0)
    before = CameraFit.started(LENS, KnownCamera(LENS, 1e-5))
    assert rounds(drive, before, 1) is before
    after = rounds(drive, CameraFit.started(LENS, KnownCamera(LENS, 0.01)), 1)
    assert after.sigma is not None and 1e-5 < after.sigma[0] < 0.01


def test_a_map_whose_equations_leave_velocities_open_leaves_the_camera() -> None:
    noise = ImuNoise(gyro_density=1e-4, accel_density=1e-3, gyro_walk=1e-5, accel_walk=1e-4, rate_hz=200.0)
    steps = 80
    at_rest = np.tile([0.0, 0.0, 9.81], (steps, 1))
    imu = ImuSegment(np.full(steps, 0.005), np.zeros((steps, 3)), at_rest, 0, np.zeros(3), np.ones((steps, 6)))
    views, link = 5, preintegrate(imu, np.zeros(6), noise)
    terms = InertialTerms([link] * (views - 1), noise, 9.81, np.zeros(6), None)
    motion = terms.start(np.zeros((views, 3)))
    state = BundleState(np.tile(np.eye(3), (views, 1, 1)), np.zeros((views, 3)), np.empty((0, 3)), motion)
    none = np.empty(0, dtype=np.int64)
    seen = Observations(none, none, np.empty((0, 2)), LENS.T_cam_body_matrix, LENS.fx)
    with pytest.raises(DegenerateGeometry):
        information_on(state, seen, terms, 1.5, np.empty((0, 2, SIZE)))
    fit = CameraFit.started(LENS, KnownCamera(LENS, 0.01))
    rows = [RowMotion(np.empty(0), np.zeros(3), np.zeros(3))] * views
    assert fit.improved(state, seen, terms, rows, 1.5) is fit
