"""Laws of calibration targets: their files, and the geometry of their corners."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from station.calibration.target import Target
from station.calibration.target_file import read_target, target_yaml

counts = st.integers(2, 12)
sides = st.floats(0.005, 0.2)
targets = st.one_of(
    st.builds(lambda c, r, s, g: Target("aprilgrid", c, r, s, gap_m=g * s), counts, counts, sides, st.floats(0.1, 1.0)),
    st.builds(lambda c, r, s: Target("chessboard", c, r, s), counts, counts, sides),
    st.builds(
        lambda c, r, s, m: Target("charuco", c, r, s, marker_m=m * s, dictionary="DICT_5X5_250"),
        counts, counts, sides, st.floats(0.3, 0.9),
    ),
)  # fmt: skip


@given(target=targets)
def test_a_target_comes_back_from_its_file(target: Target) -> None:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "target.yaml"
        path.write_text(target_yaml(target), encoding="utf-8")
        back = read_target(path)
    assert (back.kind, back.columns, back.rows, back.dictionary) == (
        target.kind, target.columns, target.rows, target.dictionary,
    )  # fmt: skip
    lengths = (target.square_m, target.gap_m, target.marker_m)
    assert (back.square_m, back.gap_m, back.marker_m) == pytest.approx(lengths, rel=1e-12)


@given(target=targets)
def test_the_corners_of_a_target_lie_on_its_grid_and_no_two_of_them_together(target: Target) -> None:
    corners = target.corners
    assert len(corners) == target.columns * target.rows * (4 if target.kind == "aprilgrid" else 1)
    assert (corners[:, 2] == 0).all() and (corners[0] == 0).all()
    distances = np.linalg.norm(corners[:, None] - corners[None], axis=2)[~np.eye(len(corners), dtype=bool)]
    nearest = target.square_m if target.kind != "aprilgrid" else min(target.square_m, target.gap_m)
    assert distances.min() == pytest.approx(nearest)


@given(target=targets.filter(lambda t: t.kind == "aprilgrid"))
def test_a_tags_corners_go_round_it_anticlockwise_from_the_lower_left(target: Target) -> None:
    for tag in target.corners.reshape(-1, 4, 3)[:, :, :2]:
        sides = np.roll(tag, -1, axis=0) - tag
        assert np.linalg.norm(sides, axis=1) == pytest.approx(target.square_m)
        turns = sides[:, 0] * np.roll(sides, -1, axis=0)[:, 1] - sides[:, 1] * np.roll(sides, -1, axis=0)[:, 0]
        assert (turns > 0).all()
        assert (tag[0] == tag.min(axis=0)).all()
