"""Square roots of covariances: whatever rotation they went through, the covariance is the same."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from shared.geometry import FloatArray
from station.slam.ukf.filter.roots import InformationRoot, shrink


def is_lower(S: FloatArray) -> bool:
    return np.array_equal(np.tril(S), S)


@given(
    seed=st.integers(0, 10_000),
    n=st.integers(1, 40),
    appended=st.integers(0, 30),
    removed=st.integers(0, 12),
    repeated=st.integers(0, 6),
)
def test_shrinking_keeps_the_covariance(seed: int, n: int, appended: int, removed: int, repeated: int) -> None:
    rng = np.random.default_rng(seed)
    S = np.tril(rng.normal(size=(n, n)))
    S = S[np.sort(rng.permutation(n)[: max(1, n - removed)])]
    S = np.insert(S, rng.integers(0, len(S) + 1), S[: min(repeated, len(S))], axis=0)
    S = np.concatenate([S, rng.normal(size=(len(S), appended)) * (rng.random(size=(len(S), 1)) < 0.5)], axis=1)
    L = shrink(S)
    assert L.shape == (len(S), len(S))
    assert is_lower(L)
    assert np.allclose(L @ L.T, S @ S.T, atol=1e-10 * max(1.0, float(np.abs(S).max()) ** 2 * n))


def test_what_is_triangular_already_stays_as_it_is() -> None:
    L = np.tril(np.random.default_rng(0).normal(size=(20, 20)))
    assert np.array_equal(shrink(L), L)
    assert np.array_equal(shrink(np.concatenate([L, np.zeros((20, 3))], axis=1)), L)


@given(seed=st.integers(0, 10_000), n=st.integers(1, 30), rows=st.integers(1, 60))
def test_dividing_by_the_information_root_is_the_kalman_update_and_stays_triangular(
    seed: int, n: int, rows: int
) -> None:
    rng = np.random.default_rng(seed)
    S, A, b = np.tril(rng.normal(size=(n, n))), rng.normal(size=(rows, n)), rng.normal(size=n)
    M = np.eye(n) + A.T @ A
    root = InformationRoot(A)
    updated = root.divide(S)
    assert is_lower(updated)
    assert np.allclose(updated @ updated.T, S @ np.linalg.solve(M, S.T), atol=1e-9 * n)
    assert np.allclose(root.solve(b), np.linalg.solve(M, b), atol=1e-9)


def test_measurements_that_are_no_numbers_give_none() -> None:
    root = InformationRoot(np.full((2, 3), np.nan))
    assert np.isnan(root.solve(np.ones(3))).any()
    assert np.isnan(root.divide(np.eye(3))).any()
