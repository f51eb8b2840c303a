"""Many poses out of a file at once are those of one after the other."""

from __future__ import annotations

import numpy as np
import pytest

from shared.geometry import FloatArray, pose, poses


def table() -> FloatArray:
    rng = np.random.default_rng(5)
    q = rng.normal(size=(500, 4))
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    return np.hstack([rng.normal(size=(500, 3)), q]).round(4)


def test_all_at_once_are_those_of_one_after_the_other_to_the_last_bit() -> None:
    rows = table()
    assert (poses(rows[:, :3], rows[:, 3:]) == np.stack([pose(row[:3], row[3:]) for row in rows])).all()


@pytest.mark.parametrize(("column", "value"), [(1, np.nan), (0, np.inf), (2, 1e308), (4, np.nan), (5, 2.0), (6, 1e308)])
def test_the_first_that_is_none_is_named(column: int, value: float) -> None:
    rows = table()
    rows[[7, 9], column] = value
    with pytest.raises(ValueError, match="is no pose") as refused:
        poses(rows[:, :3], rows[:, 3:])
    assert str(rows[7, :3].tolist()) in str(refused.value)
