"""`station calibrate camera` on rendered and on real images: the contract's object, files, refusals with a remedy."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner, Result

from shared.calibration import CameraCalibration
from shared.errors import DataError
from shared.sensor_yaml import read_bare_camera
from station.calibration.camera_files import read_camchain
from station.calibration.target_file import target_yaml
from station.calibration.target_page import page_target
from station.main import app
from tests.support.paths import RECORDINGS
from tests.support.target_images import Image, T_cam_board, photograph, printed_page

pytestmark = pytest.mark.computing

CAMERA = CameraCalibration(
    width=480, height=360, fx=400.0, fy=396.0, cx=246.0, cy=177.0, distortion=(-0.2, 0.05, 3e-4, -2e-4)
)
KEYS = {
    "model", "resolution", "intrinsics", "distortion", "rms_px", "sigma", "images_used", "images_rejected", "coverage",
    "line_delay_s", "accepted", "reasons",
}  # fmt: skip


def run(*arguments: str | Path) -> Result:
    result = CliRunner().invoke(app, ["calibrate", "camera", *map(str, arguments)])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


def report(result: Result) -> dict[str, Any]:
    content = json.loads(result.stdout.splitlines()[-1])
    assert set(content) == KEYS and isinstance(content, dict)
    assert content["accepted"] == (not content["reasons"]) == (result.exit_code == 0)
    return content


@pytest.fixture(scope="module")
def images(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A target and a folder of twelve images of it, without any description of the camera."""
    root = tmp_path_factory.mktemp("images")
    target = page_target("aprilgrid", "A4")
    (root / "target.yaml").write_text(target_yaml(target))
    (root / "good").mkdir()
    page, rng = printed_page(target), np.random.default_rng(4)
    for i in range(12):
        tilt = np.array([*rng.uniform(-0.6, 0.6, 2), rng.uniform(-0.6, 0.6)])
        shift = (float(rng.uniform(-0.35, 0.35)), float(rng.uniform(-0.25, 0.25)))
        image = photograph(page, CAMERA, T_cam_board(target, tilt, float(rng.uniform(0.26, 0.4)), shift), seed=i)
        cv2.imwrite(str(root / "good" / f"{i:02d}.png"), image)
    return root


def changed(images: Path, folder: Path, change: Any) -> Path:
    folder.mkdir()
    for path in sorted((images / "good").glob("*.png")):
        cv2.imwrite(str(folder / path.name), change(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)))
    return folder


def test_a_folder_of_images_gives_the_camera_and_files_that_are_read(images: Path, tmp_path: Path) -> None:
    out, chain, plots = tmp_path / "camera.yaml", tmp_path / "camchain.yaml", tmp_path / "fit.png"
    (images / "good" / "not_a_picture.png").write_bytes(b"broken")
    options = ("--target", images / "target.yaml", "--out", out, "--kalibr", chain, "--plots", plots, "--json")
    result = run(images / "good", *options)
    (images / "good" / "not_a_picture.png").unlink()
    found = report(result)
    assert found["accepted"] and found["model"] == "radtan" and found["resolution"] == [480, 360]
    assert found["intrinsics"] == pytest.approx([CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy], rel=0.01)
    assert [item["image"] for item in found["images_rejected"]] == ["not_a_picture.png"]
    assert set(found["sigma"]) == {"fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"}
    written, kalibrs = read_bare_camera(out), read_camchain(chain)
    assert [written.fx, written.fy, written.cx, written.cy] == found["intrinsics"]
    assert list(written.distortion) == list(kalibrs.distortion) == found["distortion"]
    assert plots.read_bytes().startswith(b"\x89PNG")


def test_a_person_reads_a_short_clear_result(images: Path, tmp_path: Path) -> None:
    result = run(images / "good", "--target", images / "target.yaml", "--out", tmp_path / "camera.yaml")
    assert result.exit_code == 0 and len(result.stdout.splitlines()) < 20
    assert "12 of 12 images used" in result.stdout and "fx" in result.stdout


def test_a_lens_model_that_the_images_do_not_tell_is_refused(images: Path, tmp_path: Path) -> None:
    out = tmp_path / "camera.yaml"
    options = ("--target", images / "target.yaml", "--out", out, "--model", "radtan8")
    found = report(run(images / "good", *options, "--json"))
    assert any("take --model radtan" in reason for reason in found["reasons"])
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(DataError, match="kalibr has no lens model radtan8"):
        run(images / "good", *options, "--kalibr", tmp_path / "chain.yaml")


def dark(image: Image) -> Image:
    return image // 30


def out_of_focus(image: Image) -> Image:
    return np.asarray(cv2.GaussianBlur(image, (0, 0), 4.0), dtype=np.uint8)


def mirrored(image: Image) -> Image:
    return np.asarray(image[:, ::-1])


@pytest.mark.parametrize(
    ("change", "remedy"),
    [(dark, "more light"), (out_of_focus, "turn the focus ring"), (mirrored, "switch mirroring off")],
)
def test_poor_images_are_refused_with_their_remedy(images: Path, tmp_path: Path, change: Any, remedy: str) -> None:
    out = tmp_path / "camera.yaml"
    folder = changed(images, tmp_path / "poor", change)
    result = run(folder, "--target", images / "target.yaml", "--out", out, "--json")
    assert result.exit_code == 2 and not out.exists()
    assert remedy in report(result)["reasons"][0]


def test_another_board_than_was_told_is_named(images: Path, tmp_path: Path) -> None:
    (tmp_path / "target.yaml").write_text(target_yaml(page_target("chessboard", "A4")))
    result = run(images / "good", "--target", tmp_path / "target.yaml", "--out", tmp_path / "camera.yaml", "--json")
    assert result.exit_code == 2 and "they show an AprilGrid" in report(result)["reasons"][0]


def test_bad_input_is_refused_in_a_sentence(images: Path, tmp_path: Path) -> None:
    (tmp_path / "bad.yaml").write_text("target_type: circlegrid\n")
    for options, words in (
        ((images / "good", "--target", tmp_path / "none.yaml"), "none.yaml"),
        ((images / "good", "--target", tmp_path / "bad.yaml"), "write one of aprilgrid"),
        ((tmp_path, "--target", images / "target.yaml"), "no *.jpg or *.png"),
    ):
        with pytest.raises(DataError, match=re.escape(words)):
            run(*options, "--out", tmp_path / "camera.yaml")
    assert not (tmp_path / "camera.yaml").exists()


def recorded(name: str) -> Path:
    folder = RECORDINGS / name
    if not folder.is_dir():
        pytest.skip("the recorded images are not on this machine")
    return folder


def test_euroc_images_give_the_published_camera(tmp_path: Path) -> None:
    folder = recorded("aprilgrid_euroc")
    found = report(run(folder, "--target", folder / "target.yaml", "--out", tmp_path / "camera.yaml", "--json"))
    assert found["accepted"] and found["images_used"] == 26 and found["rms_px"] <= 0.29
    assert found["intrinsics"][:2] == pytest.approx([458.654, 457.296], rel=3.5e-3)
    assert found["intrinsics"][2:] == pytest.approx([367.215, 248.375], abs=2.5)


def test_opencvs_chessboard_gives_its_own_camera(tmp_path: Path) -> None:
    folder = recorded("opencv_chessboard")
    (tmp_path / "left").mkdir()
    for path in folder.glob("left*.jpg"):
        shutil.copy(path, tmp_path / "left")
    (tmp_path / "target.yaml").write_text(
        "target_type: checkerboard\ntargetCols: 9\ntargetRows: 6\nrowSpacingMeters: 0.025\ncolSpacingMeters: 0.025\n"
    )
    options = ("--target", tmp_path / "target.yaml", "--out", tmp_path / "camera.yaml", "--json")
    found = report(run(tmp_path / "left", *options))
    assert found["accepted"] and found["images_used"] == 13
    assert found["intrinsics"] == pytest.approx([535.916, 535.916, 342.283, 235.571], rel=0.01)
