"""`station register`: the JSON is the last line, a refusal is a result, bad input is a sentence."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from shared.errors import DataError
from shared.geometry import FloatArray
from station.files.ply import write_ply
from station.main import app
from tests.support.registration_clouds import make_pair

pytestmark = pytest.mark.computing


def save(path: Path, points: FloatArray) -> Path:
    write_ply(path, {axis: points[:, i].astype(np.float32) for i, axis in enumerate("xyz")})
    return path


def test_an_accepted_registration_ends_with_its_json(tmp_path: Path) -> None:
    pair = make_pair(9101, overlap=(0.8, 1.0), points=(3000, 4000))
    arguments = [str(save(tmp_path / "a.ply", pair.target)), str(save(tmp_path / "b.ply", pair.source)), "--json"]
    result = CliRunner().invoke(app, ["register", *arguments])
    assert result.exit_code == 0, result.output
    answer = json.loads(result.stdout.splitlines()[-1])
    assert answer["accepted"] is True and answer["backend"] == "small_gicp"
    assert np.allclose(answer["T_target_source"], pair.T_target_source, atol=0.05)
    assert {"scale", "rmse", "inlier_ratio", "overlap", "seconds", "reasons"} <= answer.keys()
    assert 0 < answer["uncertainty"]["position"] < 0.05 and answer["uncertainty"]["scale"] == 0
    assert np.shape(answer["covariance"]) == (7, 7) and len(answer["eigenvalues"]) == 6
    told = CliRunner().invoke(app, ["register", *arguments[:2]]).stdout
    assert re.search(r"one standard deviation: 0\.\d{3} degrees, 0\.\d{4}\n", told), told


@pytest.mark.parametrize("count", [0, 1, 10])
def test_too_few_points_are_refused_with_a_reason_and_no_transform(tmp_path: Path, count: int) -> None:
    pair = make_pair(9101, points=(3000, 3500))
    a, b = save(tmp_path / "a.ply", pair.target), save(tmp_path / "b.ply", pair.source[:count])
    result = CliRunner().invoke(app, ["register", str(a), str(b), "--json"])
    assert result.exit_code == 2
    answer = json.loads(result.stdout.splitlines()[-1])
    assert answer["accepted"] is False and answer["T_target_source"] is None and answer["uncertainty"] is None
    assert f"{count} usable points" in answer["reasons"][0]


def test_a_cloud_without_a_finite_point_is_refused_as_such(tmp_path: Path) -> None:
    pair = make_pair(9101, points=(3000, 3500))
    a, b = save(tmp_path / "a.ply", pair.target), save(tmp_path / "b.ply", np.full((300, 3), np.nan))
    result = CliRunner().invoke(app, ["register", str(a), str(b)])
    assert result.exit_code == 2
    assert "refused: the source cloud holds no finite point" in result.stdout


def test_a_missing_file_is_one_sentence(tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["register", str(tmp_path / "no.ply"), str(tmp_path / "no.ply")])
    assert result.exit_code != 0
    assert isinstance(result.exception, DataError) and "no.ply" in str(result.exception)
