"""Exponential and logarithm of SO(3) and SE_k(3), also near 0 and near pi."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
from hypothesis import given, settings
from hypothesis import strategies as st

from shared.geometry import FloatArray, gammas, skew, slerp, so3_exp, so3_log
from station.motion import lie

ANGLES = [0.0, 1e-12, 1e-7, 9e-5, 1.1e-4, 5e-3, 0.011, 0.09, 0.11, 1.0, 2.9, 3.05, np.pi - 1e-4, np.pi - 1e-9, np.pi]
K = 4


def element(angle: float, seed: int) -> tuple[FloatArray, FloatArray]:
    rng = np.random.default_rng(seed)
    axis = rng.normal(size=3)
    return axis / np.linalg.norm(axis) * angle, rng.normal(size=(K, 3)) * 3.0


def as_matrix(R: FloatArray, X: FloatArray) -> FloatArray:
    """Thesis eq. B.5."""
    M = np.eye(3 + len(X))
    M[:3, :3] = R
    M[:3, 3:] = X.T
    return M


def algebra_matrix(phi: FloatArray, xi: FloatArray) -> FloatArray:
    M = np.zeros((3 + len(xi), 3 + len(xi)))
    M[:3, :3] = skew(phi)
    M[:3, 3:] = xi.T
    return M


angles = st.one_of(st.sampled_from(ANGLES), st.floats(0, np.pi))
seeds = st.integers(0, 10**6)


@given(angle=angles, seed=seeds)
@settings(max_examples=80, deadline=None)
def test_exp_is_the_matrix_exponential(angle: float, seed: int) -> None:
    phi, xi = element(angle, seed)
    expected = scipy.linalg.expm(algebra_matrix(phi, xi))
    assert np.allclose(as_matrix(*lie.exp(phi, xi)), expected, atol=1e-9)


@given(angle=angles, seed=seeds)
@settings(max_examples=80, deadline=None)
def test_log_inverts_exp(angle: float, seed: int) -> None:
    phi, xi = element(angle, seed)
    back_phi, back_xi = lie.log(*lie.exp(phi, xi))
    if angle > np.pi - 1e-6:  # phi and -phi are the same rotation there
        assert np.allclose(so3_exp(back_phi), so3_exp(phi), atol=1e-7)
    else:
        assert np.allclose(back_phi, phi, atol=1e-8)
        assert np.allclose(back_xi, xi, atol=1e-6)


@given(angle=angles, seed=seeds)
@settings(max_examples=50, deadline=None)
def test_the_other_way_is_the_inverse(angle: float, seed: int) -> None:
    phi, xi = element(angle, seed)
    there, back = as_matrix(*lie.exp(phi, xi)), as_matrix(*lie.exp(-phi, -xi))
    assert np.allclose(there @ back, np.eye(3 + K), atol=1e-9)


@pytest.mark.parametrize("angle", [a for a in ANGLES if a < 3.1])
def test_jacobian_inverse_and_integrals(angle: float) -> None:
    phi, _ = element(angle, 3)
    assert np.allclose(lie.so3_left_jacobian(phi) @ lie.so3_left_jacobian_inverse(phi), np.eye(3), atol=1e-10)
    # Gamma_1 and Gamma_2 are the first and second integral of exp(s phi) over s in [0, 1]
    nodes, weights = np.polynomial.legendre.leggauss(20)
    s, w = 0.5 * (nodes + 1.0), 0.5 * weights
    R = so3_exp(s[:, None] * phi)
    assert np.allclose(np.einsum("n,nij->ij", w, R), lie.so3_left_jacobian(phi), atol=1e-11)
    assert np.allclose(np.einsum("n,nij->ij", w * (1.0 - s), R), gammas(phi, (2,))[0], atol=1e-11)


def test_batches_agree_with_single_elements() -> None:
    elements = [element(angle, i) for i, angle in enumerate(ANGLES)]
    phi, xi = np.stack([e[0] for e in elements]), np.stack([e[1] for e in elements])
    R, X = lie.exp(phi, xi)
    for i, (p, x) in enumerate(elements):
        assert np.allclose(R[i], lie.exp(p, x)[0]) and np.allclose(X[i], lie.exp(p, x)[1])
        assert np.allclose(so3_log(R)[i], so3_log(R[i]))


@given(angle=st.floats(0.0, 3.0), fraction=st.floats(0.0, 1.0), seed=seeds)
def test_slerp_goes_the_shortest_way_at_an_even_pace(angle: float, fraction: float, seed: int) -> None:
    R_a, turn = so3_exp(element(1.0, seed + 1)[0]), element(angle, seed)[0]
    R_b = R_a @ so3_exp(turn)
    assert np.allclose(slerp(R_a, R_b, 0.0), R_a, atol=1e-9) and np.allclose(slerp(R_a, R_b, 1.0), R_b, atol=1e-9)
    assert np.allclose(so3_log(R_a.T @ slerp(R_a, R_b, fraction)), fraction * turn, atol=1e-7)
    several = slerp(np.stack([R_a, R_b]), np.stack([R_b, R_a]), np.array([fraction, 1.0 - fraction]))
    assert np.allclose(several[0], several[1], atol=1e-7)
