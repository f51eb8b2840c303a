"""Learn how sure a registration may be of itself: the numbers in station/places/registration/verify.py.

    python -m benchmarks.fit_registration_verdict [--pairs 100] [--rows FILE.jsonl]

Logistic regression (weight decay 1 on standardised features) on the training seeds of every set of
bench_registration.py but "mis-scaled". `--rows` keeps what was measured, and goes on from there. Beside the weights it
prints, by ten-fold cross validation, how many right and wrong alignments would have been believed at several limits.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from sklearn.linear_model import LogisticRegression

from benchmarks.bench_registration import FIRST_SEED, SETS, errors_of, is_right
from shared.geometry import FloatArray
from station.places.registration.register import register_clouds
from station.places.registration.verify import WEIGHTS
from tests.support.registration_clouds import make_pair

# A wrong unit has a check of its own in verify.py; the seven figures cannot see it.
LEARNED = [name for name in SETS if "unit_error" not in SETS[name]]
LIMITS = (0.5, 0.7, 0.8, 0.85, 0.9, 0.95)


def measure(name: str, seed: int) -> dict[str, Any]:
    """One training pair: the features of what was found, and how far off it is."""
    pair = make_pair(seed, shared_landmarks=bool(seed % 2), **SETS[name])
    found = register_clouds(pair.target, pair.source, scale="free" if "scale_range" in SETS[name] else "known")
    e = None
    if pair.T_target_source is not None and found.T_target_source is not None:
        e = errors_of(found.T_target_source, pair)
    return {
        "set": name,
        "seed": seed,
        "errors": e,
        "right": e is not None and is_right(e),
        "accepted": found.accepted,
        "reasons": found.reasons,
        "measured": found.measured,
        "overlap": found.overlap,
        "sigmas": [] if found.covariance is None else np.sqrt(np.diag(found.covariance)).tolist(),
        "eigenvalues": [] if found.eigenvalues is None else found.eigenvalues.tolist(),
        "rmse": found.rmse,
        "points": [len(pair.target), len(pair.source)],
    }


def fit(X: FloatArray, right: npt.NDArray[np.bool_]) -> tuple[FloatArray, float]:
    """Weights (n,) and offset of P(right) = sigmoid(X w + b)."""
    mean, spread = X.mean(axis=0), X.std(axis=0)
    model = LogisticRegression(C=1.0, tol=1e-10, max_iter=1000).fit((X - mean) / spread, right)
    w = model.coef_[0] / spread
    return w, float(model.intercept_[0] - (w * mean).sum())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pairs", type=int, default=100, help="of each set")
    parser.add_argument("--rows", type=Path, default=None)
    a = parser.parse_args()
    rows: list[dict[str, Any]] = []
    if a.rows is not None and a.rows.exists():
        rows = [json.loads(line) for line in a.rows.read_text().splitlines()]
    done = {(row["set"], row["seed"]) for row in rows}
    for seed in range(FIRST_SEED["train"], FIRST_SEED["train"] + a.pairs):  # of all sets in turn: stop it when you like
        for name in LEARNED:
            if (name, seed) in done:
                continue
            rows.append(measure(name, seed))
            if a.rows is not None:
                with a.rows.open("a") as out:
                    out.write(json.dumps(rows[-1]) + "\n")
    rows = [row for row in rows if row["measured"]]
    X = np.array([[row["measured"][name] for name in WEIGHTS] for row in rows])
    right = np.array([row["right"] for row in rows])
    sets = np.array([row["set"] for row in rows])
    w, b = fit(X, right)
    print("WEIGHTS:", {name: round(float(v), 1) for name, v in zip(WEIGHTS, w, strict=True)}, "OFFSET:", round(b, 2))
    fold = np.random.default_rng(0).integers(0, 10, len(rows))
    score = np.zeros(len(rows))
    for k in range(10):
        w, b = fit(X[fold != k], right[fold != k])
        score[fold == k] = X[fold == k] @ w + b
    for limit in LIMITS:
        believed = score > np.log(limit / (1 - limit))
        counts = {
            str(name): f"{np.sum(believed & right & (sets == name))} of {np.sum(right & (sets == name))} right, "
            f"{np.sum(believed & ~right & (sets == name))} wrong"
            for name in LEARNED
        }
        print(f"believed above {limit}:", json.dumps(counts))


if __name__ == "__main__":
    main()
