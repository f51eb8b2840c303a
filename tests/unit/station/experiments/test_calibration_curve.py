"""The calibration curve: its bins are those of the error that the bench reports."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from station.experiments.calibration_curve import (
    Bin,
    calibration_bins,
    calibration_error,
    draw_calibration,
    wilson_interval,
)


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
    assert wilson_interval(0, 0) == (0.0, 1.0)


def test_curves_are_drawn_with_their_names_and_errors(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    probability = rng.uniform(0.0, 1.0, 400)
    curves = [
        (name, calibration_bins((float(p), bool(rng.random() < p**2)) for p in probability))
        for name in ("homes", "plain homes")
    ]
    figure = tmp_path / "new" / "curve.png"
    draw_calibration(curves, figure)
    image = cv2.imread(str(figure))
    assert image is not None and image.std() > 10
