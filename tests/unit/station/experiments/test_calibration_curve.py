"""The calibration curve: its bins are those of the error that the bench reports, and it is drawn from earlier rows."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from station.experiments.calibration_curve import Bin, calibration_bins, calibration_error
from tests.support.paths import ROOT


def made_up_navigation(seed: int) -> dict[str, Any]:
    rng = np.random.default_rng(seed)
    probability = np.where(rng.random(400) < 0.7, rng.uniform(0.9, 1.0, 400), rng.uniform(0.0, 1.0, 400))
    rows = [["known", bool(rng.random() < p**2), float(p), bool(rng.random() < 0.9), False] for p in probability]
    return {"target": "mapped", "noticed_s": 1.0, "right_after_s": 4.0, "wrong_known_after": 0, "answers_after": 40,
            "rows": [*rows, ["lost", False, 0.0, True, False]]}  # fmt: skip


def test_shares_and_probabilities_are_counted_by_tenths() -> None:
    answers = [(1.0, True), (0.95, True), (0.92, False), (0.9, True), (0.31, False), (0.0, False)]
    bins = calibration_bins(answers)
    assert [(b.count, b.right) for b in bins] == [(1, 0), (1, 0), (4, 3)]
    assert [b.probability for b in bins] == pytest.approx([0.0, 0.31, 0.9425])
    assert calibration_error(bins) == pytest.approx((0.31 + 4 * (0.9425 - 0.75)) / 6)
    assert calibration_bins([]) == () and calibration_error(()) == 0.0


def test_few_answers_prove_little() -> None:
    few, many = Bin(4, 0.95, 4).interval, Bin(400, 0.95, 400).interval
    assert few == pytest.approx((0.510, 1.0), abs=1e-3) and few[1] == 1.0  # of all right, the textbook's n / (n + z^2)
    assert few[0] < many[0] < 1.0
    low, high = Bin(100, 0.5, 50).interval
    assert low == pytest.approx(0.4038, abs=1e-4) and low + high == pytest.approx(1.0)


def test_the_curve_is_drawn_from_what_earlier_runs_left(tmp_path: Path) -> None:
    files = []
    for seed in (1, 2):
        files.append(tmp_path / f"run{seed}.json")
        files[-1].write_text(json.dumps({"summary": {}, "drives": [made_up_navigation(seed)]}))
    bench = [sys.executable, "-m", "benchmarks.bench_current_place", "--from", *map(str, files)]
    figure = tmp_path / "new" / "curve.png"
    done = subprocess.run([*bench, "--figure", str(figure)], cwd=ROOT, check=True, capture_output=True, text=True)
    summary = json.loads(done.stdout)
    drives = [made_up_navigation(1), made_up_navigation(2)]
    mapped = [r for d in drives for r in d["rows"] if r[0] == "known" and r[3]]
    assert summary["drives"] == 2 and summary["expected_calibration_error"] > 0.05
    bins = calibration_bins((r[2], r[1]) for r in mapped)
    assert calibration_error(bins) == pytest.approx(summary["expected_calibration_error"])
    image = cv2.imread(str(figure))
    assert image is not None and image.std() > 10
