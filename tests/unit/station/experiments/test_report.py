"""The report's table beside the thesis, and the RMSE in its unit."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from shared.geometry import se3, yaw_rotation
from station.experiments.experiment import Experiment, Story, results_dict, run_experiment
from station.experiments.report import write_experiment
from station.places.making.config import PlacesConfig, ThesisConfig
from tests.support.synthetic_home import drive, furnished_room, navigate

STORY = Story(title="Experiment", thesis={"registration RMSE": "0.0023 m", "places / locations": "10 / 6"})
BY_HAND = ThesisConfig(eps=0.25, min_pts=11, inlier_ratio=0.75)


def experiment(config: PlacesConfig, *, metric: bool = True) -> Experiment:
    home = furnished_room(3, density=300)
    T = se3(yaw_rotation(0.05), np.array([0.05, 0.02, 0.0]))
    first = navigate(home, drive(home, 31), seed=31, metric=metric)
    second = navigate(home, drive(home, 32), seed=32, T_nav_world=T, metric=metric)
    return run_experiment(first, second, config, story=STORY)


@pytest.fixture(scope="module")
def ours() -> Experiment:
    return experiment(PlacesConfig())


@pytest.fixture(scope="module")
def theirs() -> Experiment:
    return experiment(PlacesConfig(mode="thesis", thesis=BY_HAND))


def cloud_radius(done: Experiment) -> float:
    p = done.place_map.navigation.landmarks.p_world
    return float(np.linalg.norm(p - p.mean(axis=0), axis=1).max())


def test_the_thesis_its_settings_and_ours_stand_side_by_side(
    ours: Experiment, theirs: Experiment, tmp_path: Path
) -> None:
    write_experiment(replace(ours, as_thesis=theirs), tmp_path)
    results = json.loads((tmp_path / "results.json").read_text())
    assert results["as_thesis"]["mode"] == "thesis" and results["mode"] == "default"
    page = (tmp_path / "report.html").read_text()
    assert "<tr><th></th><th>the thesis</th><th>its settings, here</th><th>here</th></tr>" in page
    row = f"<td>places / locations</td><td>10 / 6</td><td>{results['as_thesis']['places']} / "
    assert row in page and f"<td>{results['places']} / {results['locations']}</td></tr>" in page
    assert "eps 0.25, min pts 11</td>" in page


def test_without_a_run_as_the_thesis_did_it_there_is_no_column_for_it(ours: Experiment, tmp_path: Path) -> None:
    write_experiment(ours, tmp_path)
    assert json.loads((tmp_path / "results.json").read_text())["as_thesis"] is None
    assert "<th>the thesis</th><th>here</th>" in (tmp_path / "report.html").read_text()


def test_an_experiment_that_the_thesis_did_not_make_is_not_compared(ours: Experiment, tmp_path: Path) -> None:
    write_experiment(replace(ours, story=Story("Mine")), tmp_path)
    assert "Beside the thesis" not in (tmp_path / "report.html").read_text()


def test_the_rmse_of_metric_clouds_is_divided_by_the_radius_of_the_map(ours: Experiment, theirs: Experiment) -> None:
    for done in (ours, theirs):
        registration = results_dict(done)["registration"]
        assert registration["rmse_normalised"] == pytest.approx(registration["rmse"] / cloud_radius(done))


def test_the_rmse_of_normalised_clouds_is_taken_as_it_is() -> None:
    done = experiment(PlacesConfig(mode="thesis", thesis=replace(BY_HAND, eps=0.08)), metric=False)
    registration = results_dict(done)["registration"]
    assert registration["rmse_normalised"] == registration["rmse"] > 0
