"""The rates behind the current place are fitted to the figures that the estimator asks, and to nothing else."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shared.geometry import FloatArray
from station.places.tracking.config import FAILS_AT_POSE, RIGHT, FailureOdds
from station.places.tracking.image_model import MatchFigures, failure_probability, log_odds
from tests.support import likelihood_fit
from tests.support.likelihood_fit import (
    each_left_out,
    failing,
    logistic,
    minimised,
    numbers,
    recognising,
    right_pose_losses,
    with_previous,
)


def row(**otherwise: Any) -> dict[str, Any]:
    return {"flat": 101, "drive": 1, "after": False, "p": [0.0, 0.0, 0.0], "heading": 0.0, "features": 500,
            "in_view": 1.0, "failed_before": 0.0, "poses": [], **otherwise}  # fmt: skip


@given(
    extent=st.floats(0.0, 3.0),
    inliers=st.integers(16, 500),
    support=st.floats(0.01, 3.0),
    features=st.integers(60, 800),
    failed_before=st.sampled_from([0.0, 1.0]),
    in_view=st.floats(0.0, 9.0),
)
def test_what_is_fitted_is_what_the_estimator_computes(
    extent: float, inliers: int, support: float, features: int, failed_before: float, in_view: float
) -> None:
    w = np.array([RIGHT.usual, RIGHT.extent, RIGHT.inliers, RIGHT.support, RIGHT.features])
    pose = {"extent": extent, "inliers": inliers, "support": support}
    assert np.dot(recognising(pose, features), w) == pytest.approx(
        log_odds(RIGHT, MatchFigures(extent, inliers, support, features))
    )
    f = FAILS_AT_POSE
    [X] = failing([row(features=features, failed_before=failed_before, in_view=in_view)], "fav")
    p = failure_probability(f, features, failed_before, in_view)
    assert np.dot(X, [f.usual, f.features, f.again, f.in_view]) == pytest.approx(np.log(p / (1 - p)), abs=1e-6)


def test_the_rates_that_made_images_up_are_found_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(likelihood_fit, "RIDGE", 0.0)
    rng = np.random.default_rng(0)
    rows, failed = [], []
    true = np.array([RIGHT.usual, RIGHT.extent, RIGHT.inliers, RIGHT.support, RIGHT.features])
    f = FailureOdds(-1.0, features=-1.0, again=2.0, in_view=-0.8)
    for _ in range(6000):
        features = int(rng.integers(80, 800))
        poses = [
            {"extent": rng.uniform(0.03, 0.5), "inliers": int(rng.integers(16, 300)), "support": rng.uniform(0.05, 0.8)}
            for _ in range(rng.integers(1, 4))
        ]
        odds = np.exp([*(np.dot(recognising(pose, features), true) for pose in poses), 0.0])
        right = rng.choice(len(odds), p=odds / odds.sum())
        for k, pose in enumerate(poses):
            pose["error_m"] = 0.1 if k == right else 2.0
        before = float(rng.random() < 0.4)
        rows.append(row(features=features, poses=poses, failed_before=before, in_view=float(rng.exponential(1.0))))
        failed.append(float(rng.random() < failure_probability(f, features, before, rows[-1]["in_view"])))
    found = minimised(right_pose_losses(rows, [0, 1, 2, 3, 4]), 5)
    np.testing.assert_allclose(found, true, atol=0.2)
    fails = logistic(failing(rows, "fav"), np.array(failed))
    np.testing.assert_allclose(fails, [f.usual, f.features, f.again, f.in_view], atol=0.2)


def test_an_image_follows_the_informative_one_before_it_in_the_same_drive() -> None:
    rows = [
        row(),
        row(features=59, poses=[{}]),  # says nothing
        row(p=[0.3, 0.0, 0.0], heading=0.2, poses=[{}]),
        row(p=[0.3, 0.0, 0.0], heading=0.2 - 2 * np.pi),
        row(after=True),  # put down elsewhere
        row(drive=3, after=True),
    ]
    for r in rows:
        del r["failed_before"]
    first, second, third, *others = with_previous(rows)
    assert "moved" not in first and not any("moved" in r or "failed_before" in r for r in others) and len(others) == 2
    assert (second["failed_before"], second["moved"]) == (1.0, pytest.approx(2.0))
    assert (third["failed_before"], third["moved"]) == (0.0, pytest.approx(0.0))


def test_a_flat_is_judged_by_what_the_others_say() -> None:
    rows = [row(flat=flat) for flat in (101, 101, 102, 103)]

    def fit(some: list[dict[str, Any]]) -> FloatArray:
        return np.array([float(r["flat"]) for r in some])

    def losses(some: list[dict[str, Any]], w: FloatArray) -> FloatArray:
        assert len(some) + len(w) == len(rows) and not {r["flat"] for r in some} & set(w)
        return np.full(len(some), some[0]["flat"] - 100.0)

    assert each_left_out(rows, fit, losses) == pytest.approx((1 + 1 + 2 + 3) / 4)
    assert numbers("101-103,200") == [101, 102, 103, 200]
