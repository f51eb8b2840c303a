"""Relative motions as bundle adjustment weighs them, and which matches a loop's wide residuals let in."""

from __future__ import annotations

import numpy as np
import pytest

from shared.geometry import so3_exp
from station.slam.mapping.odometry import DEAD_RECKONED, MOTION_START, RelativeMotions
from station.slam.mapping.odometry_bundle import BundleState
from station.slam.mapping.odometry_mapping import agreed
from station.slam.mapping.tracks import Tracks

SIGMA_M = 0.01


def straight_on(slips: bool | list[bool]) -> RelativeMotions:
    """Four poses, half a metre apart."""
    T = np.tile(np.eye(4), (4, 1, 1))
    T[:, 0, 3] = 0.5 * np.arange(4)
    return RelativeMotions(
        T_world_body=T,
        R=np.tile(np.eye(3), (3, 1, 1)),
        R_sum=np.zeros((3, 3, 3)),
        p=np.tile([0.5, 0.0, 0.0], (3, 1)),
        sigma_rotation=np.full(3, 0.002),
        sigma_position=np.full((3, 3), SIGMA_M),
        drift=DEAD_RECKONED,
        slips=np.broadcast_to(slips, 3),
    )


def poses_of(motions: RelativeMotions) -> BundleState:
    T = motions.T_world_body
    return BundleState(T[:, :3, :3].copy(), T[:, :3, 3].copy(), np.zeros((0, 3)), MOTION_START)


def stretched(motions: RelativeMotions, sigmas: float) -> BundleState:
    """The last two poses so much further away from the first two."""
    state = poses_of(motions)
    state.p_world_body[2:, 0] += sigmas * SIGMA_M
    return state


def test_a_motion_that_cannot_slip_is_never_let_go() -> None:
    filtered, wheels = straight_on(slips=False), straight_on(slips=True)
    for sigmas in (1.0, 20.0):
        assert filtered.cost(stretched(filtered, sigmas)) == pytest.approx(sigmas**2)
    assert wheels.cost(stretched(wheels, 1.0)) == pytest.approx(1.0, rel=0.1)
    assert wheels.cost(stretched(wheels, 20.0)) < 40.0


def test_only_the_motion_that_may_slip_is_let_go() -> None:
    mixed = straight_on(slips=[False, True, False])  # the second is the stretched one
    assert mixed.cost(stretched(mixed, 20.0)) < 40.0
    other = straight_on(slips=[True, False, True])
    assert other.cost(stretched(other, 20.0)) == pytest.approx(20.0**2)


@pytest.mark.parametrize("slips", [False, True, [True, False, True]])
def test_the_gradient_agrees_with_the_cost(slips: bool | list[bool]) -> None:
    motions, rng, h = straight_on(slips), np.random.default_rng(3), 1e-6
    state = poses_of(motions)
    # Steps of a sigma: Cauchy's weights are the derivative of its loss.
    state.p_world_body[1:] += rng.normal(scale=SIGMA_M, size=(3, 3))
    state.R_world_body[1:] @= so3_exp(rng.normal(scale=0.002, size=(3, 3)))
    _, g = motions.normal_equations(state)

    def cost(row: int, axis: int, step: float) -> float:
        p = state.p_world_body.copy()
        p[row, axis] += step
        return motions.cost(BundleState(state.R_world_body, p, state.points, state.motion))

    for row in range(1, 4):
        for axis in range(3):
            slope = (cost(row, axis, h) - cost(row, axis, -h)) / (2 * h)
            assert 2.0 * g[6 * row + 3 + axis] == pytest.approx(slope, rel=1e-3, abs=1e-2)


def test_only_matches_that_show_one_landmark_agree() -> None:
    # Views 0 and 1 have three features each; landmark 0 is feature 0 of both, landmark 1 is feature 1 and feature 2.
    tracks = Tracks(np.array([0, 0, 1, 1]), np.array([0, 1, 0, 1]), np.array([0, 1, 0, 2]), num_points=2)
    pairs = np.array([[0, 0], [1, 1], [1, 2], [0, 2], [2, 1]])
    [(a, b, kept)] = agreed([(0, 1, pairs)], tracks, [3, 3])
    assert (a, b) == (0, 1)
    assert kept.tolist() == [[0, 0], [1, 2]]
