"""Logistic fits of the rates behind the current place (benchmarks/fit_place_likelihoods.py)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.optimize import minimize

from shared.geometry import FloatArray
from station.places.tracking.config import (
    USUAL_EXTENT_M,
    USUAL_FEATURES,
    USUAL_INLIERS,
    USUAL_SUPPORT,
    BeliefConfig,
)
from station.places.tracking.image_model import LEAST_EXTENT_M, NONE_IN_VIEW

# On the coefficients, against the mean loss. It draws them to zero: without it extent and features of the right pose
# come out as 3.39 and -2.09 instead of 2.86 and -1.54, features of an unmapped room as 2.70 instead of 2.03, the others
# within 0.3. The loss of flats left out is the same to 0.001.
RIDGE = 1e-3


def with_previous(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Informative images with whether the one before failed, and how far the view has changed since."""
    c = BeliefConfig()
    out: list[dict[str, Any]] = []
    last: dict[str, Any] | None = None
    for row in rows:
        if row["features"] < c.informative_features:
            continue
        same = last is not None and all(row[k] == last[k] for k in ("flat", "drive", "after"))
        if last is not None and same:
            turn = abs((row["heading"] - last["heading"] + np.pi) % (2 * np.pi) - np.pi)
            moved = float(np.linalg.norm(np.subtract(row["p"], last["p"]))) / c.new_view_m + turn / c.new_view_rad
            row = {**row, "failed_before": float(not last["poses"]), "moved": moved}
        out.append(row)
        last = row
    return out


def logistic(X: FloatArray, y: FloatArray) -> FloatArray:
    """Coefficients (k,) of log odds X @ w for outcomes y 0 or 1; the first column is not shrunk."""
    return minimised(lambda w: np.logaddexp(0, -(2 * y - 1) * (X @ w)), X.shape[1])


def minimised(losses: Callable[[FloatArray], FloatArray], count: int) -> FloatArray:
    found = minimize(lambda w: losses(w).mean() + RIDGE * (w[1:] ** 2).sum(), np.zeros(count))
    return np.asarray(found.x, dtype=np.float64)


def recognising(pose: dict[str, Any], features: int) -> list[float]:
    """A row of figures, as `RecognisedOdds` weighs them."""
    return [
        1.0,
        float(np.log(max(pose["extent"], LEAST_EXTENT_M) / USUAL_EXTENT_M)),
        float(np.log(pose["inliers"] / USUAL_INLIERS)),
        float(np.log(pose["support"] / USUAL_SUPPORT)),
        float(np.log(features / USUAL_FEATURES)),
    ]


def failing(rows: list[dict[str, Any]], columns: str) -> FloatArray:
    """Rows of figures, as `FailureOdds` weighs them: f features, a again, v in view."""
    made = {
        "f": [np.log(r["features"] / USUAL_FEATURES) for r in rows],
        "a": [r["failed_before"] for r in rows],
        "v": [np.log(r["in_view"] + NONE_IN_VIEW) for r in rows],
    }
    return np.column_stack([np.ones(len(rows)), *(made[c] for c in columns)])


def right_pose_losses(rows: list[dict[str, Any]], columns: list[int]) -> Callable[[FloatArray], FloatArray]:
    """Negative log likelihood of which pose of each image was right, or none of them."""
    most = max(len(r["poses"]) for r in rows)
    X = np.full((len(rows), most, len(columns)), np.nan)
    truth = np.full(len(rows), most)
    for n, row in enumerate(rows):
        for k, pose in enumerate(row["poses"]):
            X[n, k] = np.array(recognising(pose, row["features"]))[columns]
        errors = [pose["error_m"] for pose in row["poses"]]
        if min(errors) < RIGHT_M:
            truth[n] = int(np.argmin(errors))

    def losses(w: FloatArray) -> FloatArray:
        log = np.column_stack([np.where(np.isnan(X[:, :, 0]), -np.inf, np.nan_to_num(X) @ w), np.zeros(len(rows))])
        return np.asarray(np.logaddexp.reduce(log, axis=1) - log[np.arange(len(rows)), truth])

    return losses


def each_left_out(
    rows: list[dict[str, Any]],
    fit: Callable[[list[dict[str, Any]]], FloatArray],
    losses: Callable[[list[dict[str, Any]], FloatArray], FloatArray],
) -> float:
    """Mean loss of every flat by what the others say."""
    total = 0.0
    for flat in sorted({r["flat"] for r in rows}):
        w = fit([r for r in rows if r["flat"] != flat])
        total += float(losses([r for r in rows if r["flat"] == flat], w).sum())
    return total / len(rows)


def numbers(text: str) -> list[int]:
    """`101-103,200` as [101, 102, 103, 200]."""
    ends = [part.split("-") for part in text.split(",")]
    return [n for part in ends for n in range(int(part[0]), int(part[-1]) + 1)]


RIGHT_M = 0.25  # from the true position
