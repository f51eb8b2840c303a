"""Two sides of a registration that say different things are seen."""

import numpy as np
import pytest

from benchmarks.registration_clouds import make_pair
from shared.geometry import FloatArray
from station.places.registration.cloud import prepare_cloud
from station.places.registration.parts import PartsApart, parts_apart

UNIT = 0.06  # three times the noise


def parts_with_one_side_moved(by_m: float) -> PartsApart:
    """Two drives of one flat, aligned as they truly are but for one side of the source."""
    pair = make_pair(9003, overlap=(0.9, 1.0), points=(5000, 6000))
    T = pair.T_target_source
    assert T is not None
    source = pair.source.copy()
    long_side = int(np.argmax(np.ptp(source[:, :2], axis=0)))
    moved: FloatArray = np.zeros(3)
    moved[long_side] = by_m
    source[source[:, long_side] > np.median(source[:, long_side])] += moved
    rng = np.random.default_rng(0)
    A, B = prepare_cloud(pair.target, rng), prepare_cloud(source, rng)
    return parts_apart(
        A, B, T, R_up=np.eye(3), subset=np.arange(0, len(B.points), 2), reach=0.2, unit=UNIT, upright=True,
        free_scale=False, rng=rng,
    )  # fmt: skip


def test_all_parts_of_a_right_alignment_agree() -> None:
    parts = parts_with_one_side_moved(0.0)
    assert parts.halves < 0.3 and parts.sides < 0.4


def test_sides_that_moved_against_each_other_disagree_by_as_much() -> None:
    parts = parts_with_one_side_moved(0.1)
    assert parts.sides * UNIT == pytest.approx(0.1, rel=0.4)
    assert parts.halves < 0.5 * parts.sides
