"""`station evaluate` on finished navigations: figures and JSON of the contract, sentences for mistakes."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner, Result

from shared.errors import DataError
from station.commands.evaluate import default_folder
from station.files.navigation_folder import load_navigation, save_navigation
from station.main import app
from station.maps.folder import save_map_folder
from station.places.making.build import build_map
from tests.support.paths import RECORDINGS
from tests.support.synthetic_home import drive, furnished_room, navigate

pytestmark = pytest.mark.computing

FILES = {"evaluation.json", "errors.png", "path.png"}
FLIGHT = RECORDINGS / "euroc_v1_01_flight"


def run(*arguments: str | Path) -> Result:
    result = CliRunner().invoke(app, ["evaluate", *map(str, arguments)])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A navigation, its map, and a folder of images with a true pose each."""
    root = tmp_path_factory.mktemp("recorded")
    home = furnished_room(3, density=300)
    poses = drive(home, 31, frames=45)
    navigation = navigate(home, poses, seed=31, noise_m=0.0)
    save_navigation(navigation, root / "nav")
    save_map_folder(build_map(navigation), root / "map")
    images = root / "images"
    images.mkdir()
    for k, T in enumerate(poses):
        (images / f"frame-{k:06d}.png").write_bytes(cv2.imencode(".png", np.full((12, 16), 90, np.uint8))[1].tobytes())
        np.savetxt(images / f"frame-{k:06d}.pose.txt", T)
    (images / "camera.yaml").write_text(
        "rate_hz: 10\nresolution: [16, 12]\ncamera_model: pinhole\nintrinsics: [12, 12, 7.5, 5.5]\n"
        "distortion_model: radial-tangential\ndistortion_coefficients: [0, 0, 0, 0]\n"
    )
    bare = root / "bare"
    bare.mkdir()
    for name in ("camera.yaml", "frame-000000.png"):
        (bare / name).write_bytes((images / name).read_bytes())
    return root


@pytest.fixture
def here(tmp_path: Path) -> Iterator[Path]:
    before = Path.cwd()
    os.chdir(tmp_path)
    yield tmp_path
    os.chdir(before)


def test_errors_are_printed_and_drawn(recorded: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    result = run(recorded / "nav", recorded / "images", "--out", out, "--json")
    assert result.exit_code == 0 and result.stderr == ""
    found = json.loads(result.stdout.splitlines()[-1])
    assert list(found) == ["ate_rmse", "rpe_1s_rmse", "rot_rmse_deg", "scale", "coverage", "align", "poses"]
    assert found["ate_rmse"] < 1e-6 and found["rpe_1s_rmse"] < 1e-6 and found["rot_rmse_deg"] < 1e-3
    assert found["scale"] == pytest.approx(1.0) and found["coverage"] == 1.0
    assert (found["align"], found["poses"]) == ("yaw", 45)
    assert {path.name for path in out.iterdir()} == FILES
    assert json.loads((out / "evaluation.json").read_text()) == found
    for name in ("errors.png", "path.png"):
        figure = cv2.imread(str(out / name))
        assert figure is not None and figure.shape[1] > 800


def test_a_map_stands_for_the_navigation_it_was_made_from(recorded: Path, tmp_path: Path) -> None:
    told = {
        run(recorded / name, recorded / "images", "--align", "sim3", "--out", tmp_path / "out", "--json").stdout
        for name in ("nav", "map")
    }
    assert len(told) == 1


def test_results_lie_beside_the_navigation_unless_told_otherwise(recorded: Path, here: Path) -> None:
    save_navigation(load_navigation(recorded / "nav"), here / "mine")
    first = run("mine", recorded / "images")
    assert "ATE " in first.stdout and "written to mine-evaluation" in first.stdout
    again = run("mine", recorded / "images")
    assert again.stdout == first.stdout and first.stderr == ""
    assert again.stderr == "station: the result that mine-evaluation held from before is replaced\n"
    assert {path.name for path in (here / "mine-evaluation").iterdir()} == FILES
    assert {path.name for path in here.iterdir()} == {"mine", "mine-evaluation"}
    assert default_folder(".") == Path.cwd().with_name(f"{Path.cwd().name}-evaluation")


def test_without_truth_there_is_one_sentence_and_its_own_exit_code(recorded: Path, tmp_path: Path) -> None:
    result = run(recorded / "nav", recorded / "bare", "--out", tmp_path / "out")
    assert result.exit_code == 2 and result.stdout == ""
    assert result.stderr == f"station: {recorded / 'bare'} holds no true poses; name a dataset that has them\n"
    assert not (tmp_path / "out").exists()


def test_mistakes_get_one_sentence_and_leave_nothing(recorded: Path, tmp_path: Path) -> None:
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine.txt").write_text("x")
    for words, said in (
        ((recorded / "nav", recorded / "nowhere", "--out", tmp_path / "out"), "does not exist"),
        ((recorded / "images", recorded / "images", "--out", tmp_path / "out"), "holds no map"),
        ((recorded / "nav", recorded / "images", "--last", "1", "--out", tmp_path / "out"), "share 2 times"),
        ((recorded / "nav", recorded / "images", "--out", tmp_path / "full"), "holds mine.txt"),
        ((recorded / "nav", recorded / "images", "--out", tmp_path / "full" / "mine.txt"), "is a file"),
    ):
        with pytest.raises(DataError, match=said):
            run(*words)
    assert [path.name for path in tmp_path.rglob("*")] == ["full", "mine.txt"]


@pytest.mark.skipif(not FLIGHT.is_dir(), reason="../shared/data/euroc_v1_01_flight is not here")
def test_a_real_flight_is_followed_to_centimetres(tmp_path: Path) -> None:
    followed = CliRunner().invoke(app, ["slam", str(FLIGHT), "--backend", "ukf", "--out", str(tmp_path / "nav")])
    assert followed.exit_code == 0, followed.output
    found = json.loads(run(tmp_path / "nav", FLIGHT, "--json").stdout.splitlines()[-1])
    assert found["align"] == "yaw" and found["coverage"] > 0.95
    assert 0 < found["ate_rmse"] < 0.03 and 0 < found["rpe_1s_rmse"] < 0.05 and found["rot_rmse_deg"] < 2
    assert found["scale"] == pytest.approx(1.0, abs=0.03)
