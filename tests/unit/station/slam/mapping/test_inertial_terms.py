"""The inertial terms of the map's adjustment: their derivatives, and that they know the metre and the vertical."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from shared.calibration import HeadCalibration, ImuNoise
from shared.geometry import FloatArray, so3_exp
from station.motion.head import HeadPose
from station.motion.preintegration import ImuSegment, RolledWay, preintegrate
from station.slam.mapping.inertial_terms import HeadTerms, InertialTerms, WheelTerms
from station.slam.mapping.odometry_bundle import BundleState

NOISE = ImuNoise(gyro_density=1e-4, accel_density=1e-3, gyro_walk=1e-5, accel_walk=1e-4, rate_hz=200.0)
STEP_S, VIEWS, DT_S = 0.4, 25, 0.005
SIGMA_WAY_M = 0.01  # between two views, by the wheels
SPREAD = np.array([[2.0, 0.7, 0.0], [0.7, 0.5, 0.1], [0.0, 0.1, 1.0]])  # its covariance, in squares of that
UNKNOWN_WAY = 7  # the link along which they do not say it


def stop_and_go(
    pan: FloatArray | None = None, has_wheels: bool = True, spread: FloatArray = SPREAD
) -> tuple[BundleState, InertialTerms]:
    """A robot that goes back and forth along x without turning, and the terms of its readings.

    `pan`: (VIEWS,) rad, of a head that looks about: the poses are the head's.
    """
    t = np.arange(round(STEP_S * (VIEWS - 1) / DT_S)) * DT_S
    accel = np.stack([np.cos(2.0 * t), np.zeros_like(t), np.full_like(t, 9.81)], axis=1)
    v, x = np.zeros((VIEWS, 3)), np.zeros((VIEWS, 3))
    links, per_view = [], round(STEP_S / DT_S)
    for k in range(VIEWS - 1):
        part = slice(k * per_view, (k + 1) * per_view)
        steps = np.full(per_view, DT_S)
        segment = ImuSegment(steps, np.zeros((per_view, 3)), accel[part], 0, np.zeros(3), np.ones((per_view, 6)))
        link = preintegrate(segment, np.zeros(6), NOISE)
        fall = np.array([0.0, 0.0, -9.81])
        v[k + 1] = v[k] + link.dv + fall * STEP_S
        x[k + 1] = x[k] + v[k] * STEP_S + link.dp + 0.5 * fall * STEP_S**2
        rolled = RolledWay((x[k + 1] - x[k])[:, None], SIGMA_WAY_M**2 * spread)
        links.append(replace(link, rolled=rolled if k != UNKNOWN_WAY else None))
    wheels = WheelTerms(np.array([1.0]), np.array([0.02])) if has_wheels else None
    head = None if pan is None else head_looking(pan)
    terms = InertialTerms(links, NOISE, 9.81, np.zeros(6), wheels, head)
    R = np.tile(np.eye(3), (VIEWS, 1, 1)) if head is None else head.R_body_head
    x = x if head is None else x + head.t_body_head
    return BundleState(R, x, np.zeros((0, 3)), terms.start(v)), terms


def head_looking(pan: FloatArray) -> HeadTerms:
    calibration = HeadCalibration(pivot_body=(0.05, 0.01, 0.1))
    poses = [HeadPose(calibration, np.array([angle, 0.1]), np.zeros(2), np.zeros(2)) for angle in pan]
    T = np.array([pose.T_body_head(np.zeros(2)) for pose in poses])
    axes, shifts = map(np.array, zip(*(pose.by_angles(np.zeros(2)) for pose in poses), strict=True))
    return HeadTerms(T[:, :3, :3], T[:, :3, 3], axes, shifts, 0.007)


LOOKING_ABOUT = np.sin(np.arange(VIEWS))


def moved(state: BundleState, dx: np.ndarray) -> BundleState:
    poses = dx[: 6 * VIEWS].reshape(-1, 6)
    return replace(
        state,
        R_world_body=state.R_world_body @ so3_exp(poses[:, :3]),
        p_world_body=state.p_world_body + poses[:, 3:],
        motion=state.motion + dx[6 * VIEWS :],
    )


@pytest.mark.parametrize("pan", [None, LOOKING_ABOUT], ids=["ahead", "looking about"])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_gradient_agrees_with_the_cost(seed: int, pan: FloatArray | None) -> None:
    state, terms = stop_and_go(pan)
    rng = np.random.default_rng(seed)
    size = 6 * VIEWS + terms.size
    state = moved(state, 1e-3 * rng.standard_normal(size))
    dx, h = rng.standard_normal(size), 1e-6
    numeric = (terms.cost(moved(state, h * dx)) - terms.cost(moved(state, -h * dx))) / (2 * h)
    _, g = terms.normal_equations(state)
    assert 2 * g @ dx == pytest.approx(numeric, rel=1e-4)


@pytest.mark.parametrize("pan", [None, LOOKING_ABOUT], ids=["ahead", "looking about"])
def test_a_path_of_another_scale_costs_more(pan: FloatArray | None) -> None:
    state, terms = stop_and_go(pan)
    assert terms.cost(state) < 1e-6
    constant = 3 * VIEWS + 6 * 2  # after velocities and biases of two blocks
    for scale in (0.98, 1.02):
        larger = replace(state, p_world_body=scale * state.p_world_body, motion=state.motion * scale)
        larger.motion[constant] = 1.0
        assert terms.cost(larger) > 10.0


def test_a_way_counts_by_its_covariance() -> None:
    off, cost = np.array([2e-4, -3e-4, 1e-4]), []  # little, so that the robust loss is a square
    for has_wheels in (True, False):
        state, terms = stop_and_go(has_wheels=has_wheels)
        step = np.outer(np.arange(VIEWS) > UNKNOWN_WAY + 5, off)
        cost.append(terms.cost(replace(state, p_world_body=state.p_world_body + step)))
    assert cost[0] - cost[1] == pytest.approx(off @ np.linalg.solve(SPREAD, off) / SIGMA_WAY_M**2, rel=1e-3)


def test_wheels_hold_together_what_lies_between_two_views() -> None:
    """Their speed at each view alone said little of the way between, and views that see nothing came apart."""
    cost = []
    for has_wheels in (True, False):
        state, terms = stop_and_go(has_wheels=has_wheels, spread=np.eye(3))
        step = np.outer(np.arange(VIEWS) > UNKNOWN_WAY, [0.0, 0.02, 0.0])  # where wheels say nothing
        step += np.outer(np.arange(VIEWS) > UNKNOWN_WAY + 5, [0.0, 0.05, 0.0])
        cost.append(terms.cost(replace(state, p_world_body=state.p_world_body + step)))
    slipped = (0.05 / SIGMA_WAY_M) ** 2
    assert cost[0] - cost[1] == pytest.approx(9.0 * np.log1p(slipped / 9.0), rel=1e-6)
