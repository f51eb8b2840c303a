"""Walls and gaps on planes: the likeliest sequence, what it scores, and its longest stretch."""

from __future__ import annotations

import itertools

import msgspec
import numpy as np
import pytest

from station.places.rooms.sides import best_runs, gap_costs, likeliest_walls, score_of
from station.places.rooms.wall_model import wall_model

MODEL = msgspec.structs.replace(wall_model(), door=4.0, opening=7.0, gap=8.0, gap_piece=0.5)


def odds_of(*runs: tuple[int, float]) -> np.ndarray:
    return np.concatenate([np.full(count, value) for count, value in runs])[None]


def test_a_door_is_the_gap_where_sights_pass() -> None:
    is_wall = likeliest_walls(odds_of((15, 1.0), (9, -5.0), (12, 1.0)), MODEL)[0]
    assert is_wall.tolist() == [True] * 15 + [False] * 9 + [True] * 12


def test_one_false_sight_makes_no_gap() -> None:
    assert likeliest_walls(odds_of((15, 1.0), (1, -5.0), (15, 1.0)), MODEL).all()


def test_a_gap_as_wide_as_a_door_costs_less_than_others() -> None:
    narrow, door, opening, wide = gap_costs(np.array([3, 9, 20, 35]), MODEL)
    assert door == MODEL.door < opening == MODEL.opening < narrow < wide


@pytest.mark.parametrize("seed", range(8))
def test_no_other_labels_score_more(seed: int) -> None:
    odds = np.random.default_rng(seed).normal(-1.0, 4.0, (1, 11))
    best = score_of(likeliest_walls(odds, MODEL), odds, MODEL).sum()
    every = [np.array([labels]) for labels in itertools.product([True, False], repeat=11)]
    # What begins or ends in a gap pays for it too, but not as a door: its width is not known.
    closed = [labels for labels in every if labels[0, 0] and labels[0, -1]]
    assert best >= max(score_of(labels, odds, MODEL).sum() for labels in closed) - 1e-9


def test_the_best_run_of_each_row() -> None:
    value, begin, end = best_runs(np.array([[-1.0, 2.0, 3.0, -9.0, 4.0], [-1.0, -1.0, -1.0, -1.0, -1.0]]))
    assert (value[0], begin[0], end[0]) == (5.0, 1, 3)
    assert value[1] == 0.0
