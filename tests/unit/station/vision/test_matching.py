"""Matches of descriptors against what the ratio test says, pair by pair."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from station.vision.features import Float32Array
from station.vision.matching import clearly_nearest, match_both_ways

RATIO = 0.8


def unit_vectors(rng: np.random.Generator, count: int) -> Float32Array:
    """Directions without negative parts, as RootSIFT has them; in a space of few dimensions, so that some are alike."""
    found = np.abs(rng.normal(size=(count, 4))).astype(np.float32)
    return np.asarray(found / np.linalg.norm(found, axis=1, keepdims=True))


def is_clear(to_columns: Float32Array, column: int, rivals: list[int]) -> bool:
    """Lowe's test on distances between unit vectors."""
    distance = np.sqrt(2 - 2 * to_columns.astype(float))
    return all(distance[column] < RATIO * distance[rival] for rival in rivals)


@given(seed=st.integers(0, 10_000), rows=st.integers(0, 12), columns=st.integers(1, 12), things=st.integers(1, 6))
def test_the_nearest_is_clearly_nearer_than_what_shows_something_else(
    seed: int, rows: int, columns: int, things: int
) -> None:
    rng = np.random.default_rng(seed)
    similarity = unit_vectors(rng, rows) @ unit_vectors(rng, columns).T
    before = similarity.copy()
    for owner in (None, rng.integers(0, things, columns)):
        row, column = clearly_nearest(similarity, RATIO, owner)
        shows = np.arange(columns) if owner is None else owner
        expected = []
        for i in range(rows):
            best = int(similarity[i].argmax())
            rivals = [j for j in range(columns) if shows[j] != shows[best]]
            if is_clear(similarity[i], best, rivals):
                expected.append((i, best))
        assert list(zip(row.tolist(), column.tolist(), strict=True)) == expected
        assert np.array_equal(similarity, before)


@given(seed=st.integers(0, 10_000), rows=st.integers(0, 12), columns=st.integers(0, 12))
def test_both_ways_is_what_either_way_says(seed: int, rows: int, columns: int) -> None:
    rng = np.random.default_rng(seed)
    similarity = unit_vectors(rng, rows) @ unit_vectors(rng, columns).T
    expected: set[tuple[int, int]] = set()
    if min(rows, columns) > 1:  # else there is no second nearest
        row, column = clearly_nearest(similarity, RATIO)
        column_back, row_back = clearly_nearest(similarity.T.copy(), RATIO)
        expected = {*zip(row, column, strict=True)} & {*zip(row_back, column_back, strict=True)}
    assert {(i, j) for i, j in match_both_ways(similarity, RATIO)} == expected


def test_two_equal_candidates_are_no_match_and_order_does_not_matter() -> None:
    rng = np.random.default_rng(0)
    found = rng.normal(size=(20, 128)).astype(np.float32)
    a = found / np.linalg.norm(found, axis=1, keepdims=True)
    order = rng.permutation(20)
    pairs = match_both_ways(a @ a[order].T, RATIO)
    assert len(pairs) == 20 and (order[pairs[:, 1]] == pairs[:, 0]).all()
    doubled = np.vstack([a, a[:1]])  # nobody knows which
    assert 0 not in match_both_ways(a @ doubled.T, RATIO)[:, 0]
