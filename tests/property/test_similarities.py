"""Laws of Sim(3)."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from shared.geometry import (
    FloatArray,
    carry_poses,
    inverse,
    inverse_sim3,
    rotation_of,
    scale_of,
    se3,
    sim3,
    so3_exp,
    transform,
)

VECTOR = st.tuples(*[st.floats(-3, 3)] * 3).map(np.array)
ROTATION = VECTOR.map(so3_exp)
POSE = st.builds(se3, ROTATION, VECTOR)
SIMILARITY = st.builds(sim3, st.floats(0.01, 100.0), ROTATION, VECTOR)
POINTS = np.random.default_rng(1).normal(size=(5, 3))


@given(scale=st.floats(0.01, 100.0), R=ROTATION, t=VECTOR)
def test_a_similarity_is_taken_apart_into_what_it_was_made_of(scale: float, R: FloatArray, t: FloatArray) -> None:
    T = sim3(scale, R, t)
    np.testing.assert_allclose(scale_of(T), scale, rtol=1e-12)
    np.testing.assert_allclose(rotation_of(T), R, atol=1e-12)
    np.testing.assert_allclose(transform(T, POINTS), [scale * (R @ p) + t for p in POINTS], rtol=1e-12, atol=1e-12)


@given(A=SIMILARITY, B=SIMILARITY)
def test_a_product_moves_points_by_one_after_the_other_and_multiplies_scales(A: FloatArray, B: FloatArray) -> None:
    np.testing.assert_allclose(transform(A @ B, POINTS), transform(A, transform(B, POINTS)), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(scale_of(A @ B), scale_of(A) * scale_of(B), rtol=1e-12)
    np.testing.assert_allclose(rotation_of(A @ B), rotation_of(A) @ rotation_of(B), atol=1e-12)


@given(T=SIMILARITY, pose=POSE)
def test_the_inverse_undoes_and_is_the_rigid_one_without_scale(T: FloatArray, pose: FloatArray) -> None:
    np.testing.assert_allclose(inverse_sim3(T) @ T, np.eye(4), atol=1e-9)
    np.testing.assert_allclose(T @ inverse_sim3(T), np.eye(4), atol=1e-9)
    np.testing.assert_allclose(inverse_sim3(pose), inverse(pose), atol=1e-12)


@given(T=SIMILARITY, poses=st.lists(POSE, min_size=1, max_size=4).map(np.stack))
def test_carried_poses_stay_rigid_and_see_the_carried_points_grown(T: FloatArray, poses: FloatArray) -> None:
    carried = carry_poses(T, poses)
    np.testing.assert_allclose(inverse(carried) @ carried, np.broadcast_to(np.eye(4), carried.shape), atol=1e-9)
    for before, after in zip(poses, carried, strict=True):
        seen, seen_after = (
            transform(inverse(before), POINTS),
            transform(inverse(after), transform(T, POINTS)),
        )
        np.testing.assert_allclose(seen_after, scale_of(T) * seen, rtol=1e-9, atol=1e-9)
