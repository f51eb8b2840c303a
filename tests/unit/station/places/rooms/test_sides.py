"""Walls and gaps on planes: the likeliest sequence, what it scores, and its longest stretch."""

from __future__ import annotations

import itertools

import msgspec
import numpy as np
import pytest

from station.places.rooms.sides import Doors, best_runs, gap_costs, likeliest_walls, score_of
from station.places.rooms.surfaces import DOOR_PIECES
from station.places.rooms.wall_model import wall_model

MODEL = msgspec.structs.replace(wall_model(), door=4.0, gap=8.0, gap_piece=0.5)
FRAMED = 1.0  # cost of a door whose frame shows
NO_FRAME, FRAME = 0, 1


def odds_of(*runs: tuple[int, float]) -> np.ndarray:
    return np.concatenate([np.full(count, value) for count, value in runs])[None]


def doors_of(pieces: int, planes: int = 1) -> Doors:
    """Of no door a frame shows."""
    frames = np.full((planes, pieces, len(DOOR_PIECES)), NO_FRAME, dtype=np.uint8)
    return Doors(frames, np.array([MODEL.door, FRAMED]))


def test_a_door_is_the_gap_where_sights_pass() -> None:
    is_wall = likeliest_walls(odds_of((15, 1.0), (9, -5.0), (12, 1.0)), doors_of(36), MODEL)[0]
    assert is_wall.tolist() == [True] * 15 + [False] * 9 + [True] * 12


def test_one_false_sight_makes_no_gap() -> None:
    assert likeliest_walls(odds_of((15, 1.0), (1, -5.0), (15, 1.0)), doors_of(31), MODEL).all()


def test_a_door_is_where_its_frame_shows() -> None:
    """What sights and landmarks say would fit anywhere."""
    odds, doors = odds_of((10, 1.0), (6, -5.0), (8, 0.0), (12, 1.0)), doors_of(36)
    doors.frames[0, 10, DOOR_PIECES.index(9)] = FRAME
    is_wall = likeliest_walls(odds, doors, MODEL)
    assert is_wall[0].tolist() == [True] * 10 + [False] * 9 + [True] * 17
    assert score_of(is_wall, odds, doors, MODEL).sum() == pytest.approx(10.0 - FRAMED + 12.0)


def test_a_gap_as_wide_as_a_door_costs_less_than_others() -> None:
    doors = doors_of(40, planes=4)
    doors.frames[2, 7, DOOR_PIECES.index(9)] = FRAME
    begin, pieces = np.array([7, 7, 7, 7]), np.array([3, 9, 9, 25])
    narrow, door, framed, wide = gap_costs(np.arange(4), begin, begin + pieces, doors, MODEL)
    assert doors.least().tolist() == [MODEL.door, MODEL.door, FRAMED, MODEL.door]
    assert framed == FRAMED < door == MODEL.door < narrow < wide


@pytest.mark.parametrize("seed", range(8))
def test_no_other_labels_score_more(seed: int) -> None:
    rng = np.random.default_rng(seed)
    odds, shape = rng.normal(-1.0, 4.0, (1, 11)), (1, 11, len(DOOR_PIECES))
    doors = Doors(np.arange(np.prod(shape), dtype=np.uint8).reshape(shape), rng.uniform(-4.0, 4.0, np.prod(shape)))
    best = score_of(likeliest_walls(odds, doors, MODEL), odds, doors, MODEL).sum()
    every = [np.array([labels]) for labels in itertools.product([True, False], repeat=11)]
    # What begins or ends in a gap pays for it too, but not as a door: its width is not known.
    closed = [labels for labels in every if labels[0, 0] and labels[0, -1]]
    assert best >= max(score_of(labels, odds, doors, MODEL).sum() for labels in closed) - 1e-9


def test_the_best_run_of_each_row() -> None:
    value, begin, end = best_runs(np.array([[-1.0, 2.0, 3.0, -9.0, 4.0], [-1.0, -1.0, -1.0, -1.0, -1.0]]))
    assert (value[0], begin[0], end[0]) == (5.0, 1, 3)
    assert value[1] == 0.0
