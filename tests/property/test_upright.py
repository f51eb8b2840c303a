"""Laws of the rotation that puts z up."""

from __future__ import annotations

import numpy as np
from hypothesis import assume, example, given
from hypothesis import strategies as st

from shared.geometry import FloatArray, rotation_angle, so3_exp, upright, yaw_rotation

VECTOR = st.tuples(*[st.floats(-3, 3)] * 3).map(np.array)
DIRECTION = VECTOR.filter(lambda v: float(np.linalg.norm(v)) > 1e-3)
ROTATION = VECTOR.map(so3_exp)
UP = np.array([0.0, 0.0, 1.0])


def yaw_of(axis: FloatArray) -> float:
    return float(np.arctan2(axis[1], axis[0]))


@given(up=DIRECTION, R_a_body=st.none() | ROTATION)
@example(up=UP, R_a_body=None)
@example(up=-UP, R_a_body=None)
@example(up=-UP, R_a_body=np.eye(3))
@example(up=np.array([1.0, 0.0, 0.0]), R_a_body=np.eye(3))
def test_it_is_a_rotation_that_puts_up_along_z(up: FloatArray, R_a_body: FloatArray | None) -> None:
    R = upright(up, R_a_body)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(R), 1.0)
    np.testing.assert_allclose(R @ up, np.linalg.norm(up) * UP, atol=1e-12)


@given(up=DIRECTION, yaw=st.floats(-3, 3))
def test_no_other_such_rotation_is_shorter(up: FloatArray, yaw: float) -> None:
    shortest = upright(up)
    assert rotation_angle(shortest) <= rotation_angle(yaw_rotation(yaw) @ shortest) + 1e-7


@given(up=DIRECTION, R_a_body=ROTATION)
def test_one_axis_of_the_body_looks_along_x(up: FloatArray, R_a_body: FloatArray) -> None:
    R_world_body = upright(up, R_a_body) @ R_a_body
    level = np.linalg.norm(R_world_body[:2], axis=0)
    assume(abs(level[0] - 0.31) > 1e-6 and abs(level[2] - 0.31) > 1e-6)
    forward = next(k for k in (0, 2, 1) if level[k] > 0.31)
    assert abs(yaw_of(R_world_body[:, forward])) < 1e-9


@given(up=DIRECTION, R_a_body=ROTATION, turned=ROTATION)
def test_the_frame_in_which_both_are_given_does_not_matter(
    up: FloatArray, R_a_body: FloatArray, turned: FloatArray
) -> None:
    here, there = upright(up, R_a_body), upright(turned @ up, turned @ R_a_body)
    level = np.linalg.norm((here @ R_a_body)[:2], axis=0)
    assume(abs(level[0] - 0.31) > 1e-6 and abs(level[2] - 0.31) > 1e-6)
    np.testing.assert_allclose(there @ turned, here, atol=1e-9)
