"""What a check without a target should measure: derivatives by every unknown are those of finite differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from shared.geometry import FloatArray
from station.calibration.camera_imu.unknowns import (
    BIASES,
    DELAY,
    GRAVITY,
    INTRINSICS,
    MOUNT_POSITION,
    MOUNT_ROTATION,
    SHIFT,
)
from station.calibration.targetless.rows import carried, inertial_rows, sighting_rows
from station.calibration.targetless.unknowns import POINT, STATE, Estimate
from tests.support.lively_sessions import make_lively_session

SESSION = make_lively_session(4, duration_s=3.0, is_exact=True)
INERTIAL = SESSION.inertial
TRUE = SESSION.true_estimate()
SEEDS = st.integers(0, 10_000)
STEP = 1e-6
SIGMA_PX = 0.3
# Shares of the largest change. From the middle row to another angles are added as if about one axis.
EXACT, OVER_ROWS = 1e-3, 0.03


def near_the_truth(rng: np.random.Generator) -> Estimate:
    """Nothing at zero, corners in view."""
    states = rng.normal(0.0, 1.0, (len(TRUE.t_s), STATE)) * np.repeat([2e-3, 2e-3, 1e-2], 3)
    points = rng.normal(0.0, 1.0, (len(TRUE.ray), POINT)) * [2e-3, 2e-3, 1e-2]
    border = np.zeros(TRUE.border)
    border[BIASES:] = rng.normal(0.0, 0.02, TRUE.border - BIASES)
    return TRUE.moved(states, border, points)


def stepped(now: Estimate, states: FloatArray, border: FloatArray, points: FloatArray) -> Estimate:
    """As `minimised` steps: the states are carried to where the new time shift and line delay put the images."""
    moved = now.moved(states, border, points)
    return carried(moved, SESSION.seen.t_s + moved.camera.middle_row_shift_s, INERTIAL)


@settings(max_examples=6, deadline=None)
@given(SEEDS)
def test_sightings_change_as_their_derivatives_say(seed: int) -> None:
    rng = np.random.default_rng(seed)
    now, seen = near_the_truth(rng), SESSION.seen
    rows = sighting_rows(now, seen, INERTIAL, SIGMA_PX)
    blocks: list[tuple[str, slice | int, float, float]] = [
        ("states", slice(None), 1.0, EXACT),
        ("points", slice(None), 1.0, EXACT),
        ("border", MOUNT_ROTATION, 1.0, EXACT),
        ("border", MOUNT_POSITION, 1.0, EXACT),
        ("border", slice(INTRINSICS.start, INTRINSICS.start + 4), 100.0, EXACT),
        ("border", slice(INTRINSICS.start + 4, INTRINSICS.stop), 1.0, EXACT),
        ("border", SHIFT, 1.0, OVER_ROWS),
        ("border", DELAY, 1e-3, OVER_ROWS),
    ]
    for kind, columns, size, tolerance in blocks:
        step = {
            "states": np.zeros((len(now.t_s), STATE)),
            "border": np.zeros(now.border),
            "points": np.zeros((len(now.ray), POINT)),
        }
        step[kind][..., columns] = size * rng.normal(0.0, 1.0, step[kind][..., columns].shape)
        near, far = (
            sighting_rows(stepped(now, *(s * STEP * part for part in step.values())), seen, INERTIAL, SIGMA_PX)
            for s in (-0.5, 0.5)
        )
        expected = (
            np.einsum("mis,ms->mi", rows.by_state, step["states"][seen.image])
            + rows.by_border @ step["border"][:BIASES]
            + np.einsum("mip,mp->mi", rows.by_point, step["points"][seen.corner])
        )
        assert np.abs(expected).max() > 1.0
        np.testing.assert_allclose(
            (far.residual - near.residual) / STEP, expected, rtol=0.0, atol=tolerance * np.abs(expected).max(),
            err_msg=f"{kind} {columns}",
        )  # fmt: skip


@settings(max_examples=6, deadline=None)
@given(SEEDS)
def test_inertial_readings_change_as_their_derivatives_say(seed: int) -> None:
    rng = np.random.default_rng(seed)
    now, scale = near_the_truth(rng), np.array([1.5, 2.5])
    states = rng.normal(0.0, 1.0, (len(now.t_s), STATE))
    border = np.zeros(now.border)
    border[GRAVITY] = rng.normal(0.0, 1.0, 3)
    border[BIASES:] = rng.normal(0.0, 1.0, now.border - BIASES)
    still = np.zeros((len(now.ray), POINT))
    rows = inertial_rows(now, INERTIAL, scale)
    near, far = (
        inertial_rows(now.moved(s * STEP * states, s * STEP * border, still), INERTIAL, scale) for s in (-0.5, 0.5)
    )
    both = np.concatenate([states[:-1], states[1:]], axis=1)
    nodes = border[BIASES:].reshape(-1, 6)
    of_nodes = np.concatenate([nodes[rows.node], nodes[rows.node + 1]], axis=1)
    expected = (
        np.einsum("kis,ks->ki", rows.by_states, both)
        + rows.by_gravity @ border[GRAVITY]
        + np.einsum("kib,kb->ki", rows.by_bias, of_nodes)
    )
    for part in (slice(0, 3), slice(3, 9)):  # turning, moving: of different sizes
        np.testing.assert_allclose(
            ((far.residual - near.residual) / STEP)[:, part], expected[:, part],
            rtol=0.0, atol=EXACT * np.abs(expected[:, part]).max(),
        )  # fmt: skip


def test_the_truth_explains_what_was_measured_without_noise() -> None:
    """So that the residuals mean what they say, not only their derivatives."""
    sighted = sighting_rows(TRUE, SESSION.seen, INERTIAL, 1.0)
    assert np.abs(sighted.residual).max() < 0.05  # px
    felt = inertial_rows(TRUE, INERTIAL, np.ones(2))
    assert np.abs(felt.residual).max() < 1.0  # sigma


def test_a_time_shift_moves_nothing_that_the_imu_says() -> None:
    """States that are carried to other times are the same motion: the readings between them still fit."""
    later = replace(TRUE, camera=TRUE.camera)
    later = carried(later, TRUE.t_s + 2e-3, INERTIAL)
    felt = inertial_rows(later, INERTIAL, np.ones(2))
    assert np.abs(felt.residual).max() < 1.0  # sigma
    R, p = SESSION.motion.body(later.t_s)
    assert np.abs(later.R - R).max() < 1e-4 and np.abs(later.p - p).max() < 1e-4
