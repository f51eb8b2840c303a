"""Logistic fits of what images say of where they were taken (benchmarks/fit_image_evidence.py)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import minimize

from shared.geometry import FloatArray
from station.places.making.scale import USUAL_VIEWING_M
from station.places.tracking.config import BeliefConfig
from station.places.tracking.image_evidence import LEAST_EXTENT_M, LITTLE

Row = dict[str, Any]
Losses = Callable[[list[Row], FloatArray], FloatArray]

RIDGE = 1e-3  # on the coefficients but the constant, against the mean loss: it draws them to zero
RIGHT_M = 0.5  # from the true position: a map that SLAM bent is no look-alike
FRESH = 0.7  # of what makes an image independent of the last one


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    w: FloatArray  # (k,) coefficients, the constant first
    losses: dict[str, float]  # nats per image of each kind of world, by a fit to the others


def with_previous(rows: list[Row]) -> list[Row]:
    """Informative images with whether the one before failed, and how far the view has changed since."""
    c = BeliefConfig()
    out: list[Row] = []
    last: Row | None = None
    for row in rows:
        if row["features"] < c.informative_features:
            continue
        same = last is not None and all(row[k] == last[k] for k in ("world", "drive", "after"))
        if last is not None and same:
            moved = 1.0
            if "p" in row and "p" in last:
                turn = abs((row["heading"] - last["heading"] + np.pi) % (2 * np.pi) - np.pi)
                way_m = float(np.linalg.norm(np.subtract(row["p"], last["p"])))
                moved = (way_m / USUAL_VIEWING_M + turn) / c.new_view_rad
            row = {**row, "failed_before": float(not last["poses"]), "moved": moved}
        out.append(row)
        last = row
    return out


# -- the regressions ------------------------------------------------------------------------------------------------


def fitted_right(rows: list[Row]) -> Fit:
    """Which pose of an image is right, or none of them."""
    return _fit([r for r in rows if r["mapped"] and r["poses"]], right_pose_losses, 5)


def fitted_unmapped(rows: list[Row]) -> Fit:
    """How much rarer an image is where no map knows: odds of that given the image, against those of any image."""
    informative = [r for r in rows if not r["doorway"]]
    recognised = [r for r in informative if r["poses"]]
    weight, unmapped = weights(informative), np.array([not r["mapped"] for r in informative])
    anyhow = np.log(weight[unmapped].sum() / weight[~unmapped].sum())

    def losses(some: list[Row], w: FloatArray) -> FloatArray:
        X = np.array([recognising(max(r["poses"], key=lambda p: p["inliers"]), r["features"]) for r in some])
        return _logistic_losses(X, np.array([not r["mapped"] for r in some]), w)

    found = _fit(recognised, losses, 5)
    return Fit(found.w - np.array([anyhow, 0, 0, 0, 0]), found.losses)


def fitted_failing(rows: list[Row], *, mapped: bool, with_view: bool) -> Fit:
    """That an image is not recognised."""
    mine = [r for r in rows if r.get("moved", 0.0) > FRESH and not r["doorway"] and r["mapped"] == mapped]

    def losses(some: list[Row], w: FloatArray) -> FloatArray:
        return _logistic_losses(failing(some, with_view), np.array([not r["poses"] for r in some]), w)

    return _fit(mine, losses, 4 if with_view else 3)


def usual_support(rows: list[Row]) -> float:
    """Median of right poses."""
    return float(np.median([p["support"] for r in rows for p in r["poses"] if r["mapped"] and p["error_m"] < RIGHT_M]))


# -- fitting --------------------------------------------------------------------------------------------------------


def weights(rows: list[Row]) -> FloatArray:
    """(n,) so that every kind of world has the same weight, and all together have one of 1."""
    kinds, which, count = np.unique([r["kind"] for r in rows], return_inverse=True, return_counts=True)
    return np.asarray(1.0 / (len(kinds) * count[which]), dtype=np.float64)


def _fit(rows: list[Row], losses: Losses, count: int) -> Fit:
    def found(some: list[Row]) -> FloatArray:
        weight = weights(some)
        best = minimize(lambda w: weight @ losses(some, w) + RIDGE * (w[1:] ** 2).sum(), np.zeros(count))
        return np.asarray(best.x, dtype=np.float64)

    kinds = sorted({r["kind"] for r in rows})
    loss = {}
    for kind in kinds if len(kinds) > 1 else []:
        w = found([r for r in rows if r["kind"] != kind])
        loss[kind] = float(losses([r for r in rows if r["kind"] == kind], w).mean())
    return Fit(found(rows), loss)


def recognising(pose: Row, features: int) -> list[float]:
    """A row of figures, as `RecognisedOdds` weighs them."""
    return [
        1.0,
        float(np.log(max(pose["extent"], LEAST_EXTENT_M))),
        float(np.log1p(pose["inliers"])),
        float(np.log(pose["support"])),
        float(np.log1p(features)),
    ]


def failing(rows: list[Row], with_view: bool) -> FloatArray:
    """Rows of figures, as `FailureOdds` weighs them."""
    columns = [np.ones(len(rows)), np.log1p([r["features"] for r in rows]), [r["failed_before"] for r in rows]]
    if with_view:
        columns.append(np.log([r["in_view"] + LITTLE for r in rows]))
    return np.column_stack(columns)


def right_pose_losses(rows: list[Row], w: FloatArray) -> FloatArray:
    """(n,) negative log likelihood of which pose of each image was right, or none of them."""
    most = max(len(r["poses"]) for r in rows)
    log = np.full((len(rows), most + 1), -np.inf)
    log[:, most] = 0.0
    truth = np.full(len(rows), most)
    for n, row in enumerate(rows):
        log[n, : len(row["poses"])] = np.array([recognising(p, row["features"]) for p in row["poses"]]) @ w
        errors = [pose["error_m"] for pose in row["poses"]]
        if min(errors) < RIGHT_M:
            truth[n] = int(np.argmin(errors))
    return np.asarray(np.logaddexp.reduce(log, axis=1) - log[np.arange(len(rows)), truth])


def _logistic_losses(X: FloatArray, is_so: FloatArray, w: FloatArray) -> FloatArray:
    return np.asarray(np.logaddexp(0, np.where(is_so, -1.0, 1.0) * (X @ w)))


def numbers(text: str) -> list[int]:
    """`101-103,200` as [101, 102, 103, 200]."""
    ends = [part.split("-") for part in text.split(",")]
    return [n for part in ends for n in range(int(part[0]), int(part[-1]) + 1)]
