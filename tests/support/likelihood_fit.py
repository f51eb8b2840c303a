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
from station.places.tracking.fitted import RecognisedOdds, Usual
from station.places.tracking.image_evidence import LITTLE, terms
from station.places.tracking.own_pictures import RIGHT_M

Row = dict[str, Any]
Losses = Callable[[FloatArray], FloatArray]  # of coefficients (k,): nats of each image (n,)
LossesOf = Callable[[list[Row]], Losses]

TERMS = len(RecognisedOdds.__struct_fields__)
RIDGE = 1e-3  # on the coefficients but the constant, against the mean loss: it draws them to zero
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
    """Which pose of an image is right, or none of them; `own` of a row is what its map adds to the log odds."""
    return _fit([r for r in rows if r["mapped"] and r["poses"]], right_pose_losses, TERMS)


def fitted_unmapped(rows: list[Row]) -> Fit:
    """How much rarer an image is where no map knows: odds of that given the image, against those of any image."""
    informative = [r for r in rows if not r["doorway"]]
    recognised = [r for r in informative if r["poses"]]
    weight, unmapped = weights(informative), np.array([not r["mapped"] for r in informative])
    anyhow = np.log(weight[unmapped].sum() / weight[~unmapped].sum())

    def losses(some: list[Row]) -> Losses:
        X = np.array([terms(max((p["figures"] for p in r["poses"]), key=lambda f: f.inliers)) for r in some])
        return _logistic_losses(X, np.array([not r["mapped"] for r in some]))

    found = _fit(recognised, losses, TERMS)
    return Fit(found.w - anyhow * np.eye(TERMS)[0], found.losses)


def fitted_failing(rows: list[Row], *, mapped: bool, with_view: bool) -> Fit:
    """That an image is not recognised."""
    mine = [r for r in rows if r.get("moved", 0.0) > FRESH and not r["doorway"] and r["mapped"] == mapped]

    def losses(some: list[Row]) -> Losses:
        return _logistic_losses(failing(some, with_view), np.array([not r["poses"] for r in some]))

    return _fit(mine, losses, 4 if with_view else 3)


def usual_of(rows: list[Row]) -> Usual:
    """Of the right poses."""
    right = [p["figures"] for r in rows for p in r["poses"] if r["mapped"] and p["error_m"] < RIGHT_M]
    supports = [f.support for f in right if f.support is not None]
    off_floors = [f.off_floor for f in right if f.off_floor is not None]
    return Usual(round(float(np.median(supports)), 3), round(float(np.median(off_floors)), 3))


def or_usual(row: Row, usual: Usual) -> Row:
    """An image with what nobody knows of its poses taken for what is usual."""
    return {**row, "poses": [{**pose, "figures": pose["figures"].or_usual(usual)} for pose in row["poses"]]}


# -- fitting --------------------------------------------------------------------------------------------------------


def weights(rows: list[Row]) -> FloatArray:
    """(n,) so that every kind of world has the same weight, and all together have one of 1."""
    kinds, which, count = np.unique([r["kind"] for r in rows], return_inverse=True, return_counts=True)
    return np.asarray(1.0 / (len(kinds) * count[which]), dtype=np.float64)


def _fit(rows: list[Row], losses_of: LossesOf, count: int) -> Fit:
    def found(some: list[Row]) -> FloatArray:
        weight, losses = weights(some), losses_of(some)
        best = minimize(lambda w: weight @ losses(w) + RIDGE * (w[1:] ** 2).sum(), np.zeros(count))
        return np.asarray(best.x, dtype=np.float64)

    kinds = sorted({r["kind"] for r in rows})
    loss = {}
    for kind in kinds if len(kinds) > 1 else []:
        w = found([r for r in rows if r["kind"] != kind])
        loss[kind] = float(losses_of([r for r in rows if r["kind"] == kind])(w).mean())
    return Fit(found(rows), loss)


def failing(rows: list[Row], with_view: bool) -> FloatArray:
    """Rows of figures, as `FailureOdds` weighs them."""
    columns = [
        np.ones(len(rows)),
        np.log1p([r["features"] for r in rows]),
        np.array([r["failed_before"] for r in rows], dtype=np.float64),
    ]
    if with_view:
        columns.append(np.log([r["in_view"] + LITTLE for r in rows]))
    return np.column_stack(columns)


def right_pose_losses(rows: list[Row]) -> Losses:
    """Negative log likelihood of which pose of each image was right, or none of them."""
    image = np.array([n for n, row in enumerate(rows) for _ in row["poses"]])
    number = np.array([k for row in rows for k in range(len(row["poses"]))])
    X = np.array([terms(pose["figures"]) for row in rows for pose in row["poses"]])
    most = int(number.max()) + 1
    own = np.array([row.get("own", 0.0) for row in rows])[image]
    truth = np.array([_right_pose(row, none=most) for row in rows])

    def losses(w: FloatArray) -> FloatArray:
        log = np.full((len(rows), most + 1), -np.inf)
        log[:, most] = 0.0
        log[image, number] = X @ w + own
        return np.asarray(np.logaddexp.reduce(log, axis=1) - log[np.arange(len(rows)), truth])

    return losses


def _right_pose(row: Row, none: int) -> int:
    errors = [pose["error_m"] for pose in row["poses"]]
    return int(np.argmin(errors)) if min(errors) < RIGHT_M else none


def _logistic_losses(X: FloatArray, is_so: FloatArray) -> Losses:
    sign = np.where(is_so, -1.0, 1.0)
    return lambda w: np.asarray(np.logaddexp(0, sign * (X @ w)))


def numbers(text: str) -> list[int]:
    """`101-103,200` as [101, 102, 103, 200]."""
    ends = [part.split("-") for part in text.split(",")]
    return [n for part in ends for n in range(int(part[0]), int(part[-1]) + 1)]
