"""Laws of the table of landmarks and their observations."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from shared.geometry import FloatArray, sim3, so3_exp, transform
from station.model.navigation import Keyframes, Landmarks, join_maps

VECTOR = st.tuples(*[st.floats(-3, 3)] * 3).map(np.array)
SIMILARITY = st.builds(sim3, st.floats(0.1, 10.0), VECTOR.map(so3_exp), VECTOR)


def landmarks(seed: int, keyframe: list[int], count: int = 4) -> Landmarks:
    """A few landmarks, observed at random from these keyframes."""
    rng = np.random.default_rng(seed)
    spread = rng.normal(size=(count, 3, 3))
    return Landmarks(
        p_world=rng.normal(size=(count, 3)),
        rgb=rng.integers(0, 256, (count, 3), dtype=np.uint8),
        cov_world=spread @ np.swapaxes(spread, 1, 2),
        observed_landmark=rng.integers(0, count, len(keyframe)),
        observed_keyframe=np.array(keyframe, dtype=np.int64),
        observed_uv_px=rng.uniform(0, 640, (len(keyframe), 2)),
    )


@given(keyframe=st.lists(st.integers(0, 6), max_size=40), beyond=st.integers(0, 3))
def test_every_observation_belongs_to_its_keyframe_once_and_in_order(keyframe: list[int], beyond: int) -> None:
    num_keyframes = max(keyframe, default=-1) + 1 + beyond
    rows = landmarks(1, keyframe).observations_by_keyframe(num_keyframes)
    assert [seen.tolist() for seen in rows] == [
        [row for row in range(len(keyframe)) if keyframe[row] == k] for k in range(num_keyframes)
    ]


@given(T=SIMILARITY, seed=st.integers(0, 1000))
def test_uncertainty_is_carried_along_with_the_points(T: FloatArray, seed: int) -> None:
    before = landmarks(seed, [0, 1])
    after = before.moved(T)
    np.testing.assert_allclose(after.p_world, transform(T, before.p_world))
    # The columns of a covariance's square root are displacements, which turn and grow as the cloud does.
    columns = np.moveaxis(np.linalg.cholesky(before.cov_world), 2, 0)
    root = np.stack([transform(T, before.p_world + column) - after.p_world for column in columns], axis=2)
    np.testing.assert_allclose(root @ np.swapaxes(root, 1, 2), after.cov_world, rtol=1e-6, atol=1e-6)


PARTS = st.lists(
    st.tuples(st.integers(0, 1000), st.lists(st.integers(0, 3), max_size=6), st.integers(1, 3)), min_size=1, max_size=3
)


@given(parts=PARTS)
def test_joined_landmarks_are_seen_from_their_own_keyframes(parts: list[tuple[int, list[int], int]]) -> None:
    tables = [landmarks(seed, keyframe, count) for seed, keyframe, count in parts]
    numbers = np.arange(4)
    keyframes = Keyframes(numbers, numbers, np.tile(np.eye(4), (4, 1, 1)), (b"",) * 4, np.zeros(4, dtype=np.int64))
    _, joined = join_maps([(keyframes, table) for table in tables])
    assert len(joined) == sum(len(table) for table in tables)
    seen = iter(range(len(joined.observed_landmark)))
    for number, table in enumerate(tables):
        for row in range(len(table.observed_landmark)):
            k = next(seen)
            assert joined.observed_keyframe[k] == table.observed_keyframe[row] + 4 * number
            p = table.p_world[table.observed_landmark[row]]
            assert np.array_equal(joined.p_world[joined.observed_landmark[k]], p)
            assert np.array_equal(joined.observed_uv_px[k], table.observed_uv_px[row])
    assert next(seen, None) is None
