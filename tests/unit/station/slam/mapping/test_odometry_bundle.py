"""The equations of a whole navigation are sparse and solved as such."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import bsr_matrix, csc_matrix

from station.slam.mapping import odometry_bundle
from station.slam.mapping.odometry_bundle import MIN_FILLED, factored


def chain(num_poses: int, reach: int) -> csc_matrix:
    """Positive definite equations of poses that share landmarks with the next few, and the first with the last."""
    rng = np.random.default_rng(3)
    apart = np.abs(np.arange(num_poses)[:, None] - np.arange(num_poses))
    row, column = np.nonzero((apart <= reach) | (apart == num_poses - 1))
    begin = np.concatenate([[0], np.cumsum(np.bincount(row))])
    J = bsr_matrix((rng.normal(size=(len(row), 6, 6)), column, begin)).tocsc()
    return (J.T @ J + csc_matrix(np.eye(6 * num_poses))).tocsc()


@pytest.mark.parametrize("reach", [2, 40])  # 40: so many of them depend on each other that they are solved as full ones
def test_equations_are_solved_alike_as_sparse_and_as_full_ones(reach: int, monkeypatch: pytest.MonkeyPatch) -> None:
    S = chain(300, reach)
    assert (S.nnz > MIN_FILLED * S.shape[0] ** 2) == (reach == 40)
    rhs = np.random.default_rng(4).normal(size=(len(S.toarray()), 3))
    found = factored(S)(rhs)
    np.testing.assert_allclose(S @ found, rhs, atol=1e-9)
    monkeypatch.setattr(odometry_bundle, "MAX_DENSE", 0)
    np.testing.assert_allclose(factored(S)(rhs), found, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("max_dense", [4200, 0])
@pytest.mark.parametrize("least", [0.0, -1.0])  # eigenvalue
def test_equations_that_leave_something_open_are_refused(
    least: float, max_dense: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(odometry_bundle, "MAX_DENSE", max_dense)
    with pytest.raises(np.linalg.LinAlgError):
        factored(csc_matrix(np.diag([2.0, 1.0, least])))
