"""Symmetric equations are solved where they are positive definite, and refused where they are not."""

from __future__ import annotations

from unittest.mock import patch

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.sparse import csc_matrix

from station.slam.mapping import odometry_bundle
from station.slam.mapping.odometry_bundle import MAX_DENSE, factored

SMALL = st.integers(1, 7).flatmap(lambda n: arrays(np.int64, (n, n), elements=st.integers(-3, 3)))


@pytest.mark.parametrize("max_dense", [MAX_DENSE, 0])
@given(half=SMALL, lift=st.integers(0, 30))
@example(half=np.array([[0, 1], [0, 0]]), lift=0)  # its rows change places, and then both pivots are 1
def test_they_are_solved_exactly_where_no_eigenvalue_is_negative(
    half: npt.NDArray[np.int64], lift: int, max_dense: int
) -> None:
    S = (half + half.T + lift * np.eye(len(half))).astype(np.float64)
    least = np.linalg.eigvalsh(S)[0]
    assume(abs(least) > 1e-6)  # else rounding decides
    with patch.object(odometry_bundle, "MAX_DENSE", max_dense):
        if least < 0:
            with pytest.raises(np.linalg.LinAlgError):
                factored(csc_matrix(S))
        else:
            rhs = np.arange(len(S), dtype=np.float64)
            np.testing.assert_allclose(S @ factored(csc_matrix(S))(rhs), rhs, atol=1e-6)
