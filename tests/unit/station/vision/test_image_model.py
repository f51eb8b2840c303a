"""A network from a file: what it is shown, and files that none can be run from."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from shared.errors import DataError
from station.model.frames import ImageArray
from station.vision import image_model
from station.vision.image_model import ImageModel
from tests.support.onnx_models import (
    SIDE_PX,
    save_colour_classifier,
    save_colour_detector,
    save_colour_embedding,
    save_text_answer,
)


def wide(middle: tuple[int, int, int], borders: tuple[int, int, int]) -> ImageArray:
    """A picture (48, 96, 3) whose middle square has one colour, and what lies beside it another (red, green, blue)."""
    picture = np.full((48, 96, 3), borders[::-1], dtype=np.uint8)
    picture[:, 24:72] = middle[::-1]
    return picture


def test_the_middle_of_a_picture_is_shown_red_first_in_0_to_1(tmp_path: Path) -> None:
    model = ImageModel(save_colour_embedding(tmp_path / "m.onnx"), "unit")
    seen = model(wide((255, 51, 0), (0, 0, 255)))
    np.testing.assert_allclose(seen, [1.0, 0.2, 0.0], atol=0.03)


def test_colours_are_normalised_as_the_model_was_trained(tmp_path: Path) -> None:
    path = save_colour_embedding(tmp_path / "m.onnx")
    grey = np.full((40, 40, 3), 128, np.uint8)
    np.testing.assert_allclose(
        ImageModel(path, "imagenet")(grey),
        (128 / 255 - np.array([0.485, 0.456, 0.406])) / [0.229, 0.224, 0.225],
        atol=1e-3,
    )
    assert ImageModel(path, "clip")(grey) == pytest.approx([0.076, 0.169, 0.339], abs=2e-3)


def test_a_detector_is_shown_the_whole_picture_on_grey(tmp_path: Path) -> None:
    seen = ImageModel(save_colour_detector(tmp_path / "m.onnx"), "unit")(wide((255, 0, 0), (0, 0, 255)))
    assert seen.shape == (7, 1)
    np.testing.assert_allclose(seen[4:, 0], [0.25 + 57 / 255, 57 / 255, 0.25 + 57 / 255], atol=0.03)


def test_a_size_that_the_file_leaves_open_is_asked_for(tmp_path: Path) -> None:
    path = save_colour_embedding(tmp_path / "m.onnx", ("batch", 3, "height", "width"))
    with pytest.raises(DataError, match="give --size"):
        ImageModel(path, "unit")
    assert ImageModel(path, "unit", 64)(np.zeros((10, 20, 3), np.uint8)).shape == (3,)
    for side in (8, 4096):
        with pytest.raises(DataError, match="16 to 2048 px"):
            ImageModel(path, "unit", side)
    with pytest.raises(DataError, match="leave --size 64 out"):
        ImageModel(save_colour_embedding(tmp_path / "fixed.onnx"), "unit", 64)


@pytest.mark.parametrize(
    ("shape", "words"),
    [
        ((1, 1, SIDE_PX, SIDE_PX), "takes an input of shape 1 x 1 x 32 x 32"),
        ((8, 3, SIDE_PX, SIDE_PX), "single colour pictures"),
        ((1, 3, SIDE_PX, 64), "square pictures"),
        ((1, 3, SIDE_PX), "single colour pictures"),
    ],
)
def test_inputs_that_are_no_picture_are_refused(tmp_path: Path, shape: tuple[int, ...], words: str) -> None:
    with pytest.raises(DataError, match=words) as caught:
        ImageModel(save_colour_embedding(tmp_path / "m.onnx", shape), "unit")
    assert str(tmp_path / "m.onnx") in str(caught.value)


def test_files_that_are_no_model_are_refused_in_a_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "text.onnx").write_text("version https://git-lfs.github.com/spec/v1\n")
    whole = save_colour_embedding(tmp_path / "m.onnx").read_bytes()
    (tmp_path / "cut.onnx").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "empty.onnx").write_bytes(b"")
    for name in ("text.onnx", "cut.onnx", "empty.onnx"):
        with pytest.raises(DataError, match="no ONNX file") as caught:
            ImageModel(tmp_path / name, "unit")
        assert name in str(caught.value) and "\n" not in str(caught.value)
    for path in (tmp_path, tmp_path / "none.onnx", Path("/dev/null")):
        with pytest.raises(DataError, match="is no file"):
            ImageModel(path, "unit")
    monkeypatch.setattr(image_model, "MAX_MODEL_BYTES", 10)
    with pytest.raises(DataError, match="larger than an ONNX file can be"):
        ImageModel(tmp_path / "m.onnx", "unit")


def test_answers_that_are_no_numbers_are_refused(tmp_path: Path) -> None:
    model = ImageModel(save_colour_classifier(tmp_path / "m.onnx", [[np.inf, 0], [0, 0], [0, 0]]), "unit")
    with pytest.raises(DataError, match="numbers that are none"):
        model(np.zeros((10, 10, 3), np.uint8))


def test_answers_in_words_and_answers_that_are_too_long_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    picture = np.zeros((10, 10, 3), np.uint8)
    with pytest.raises(DataError, match="must be numbers"):
        ImageModel(save_text_answer(tmp_path / "words.onnx"), "unit")(picture)
    monkeypatch.setattr(image_model, "MAX_OUTPUTS", 2)
    with pytest.raises(DataError, match=r"3 numbers, more than the 2 that are read; .* a smaller --size"):
        ImageModel(save_colour_embedding(tmp_path / "m.onnx"), "unit")(picture)


def test_without_the_extra_a_sentence_says_how_to_get_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    with pytest.raises(DataError, match=r"pip install .*\[labels\]"):
        ImageModel(tmp_path / "m.onnx", "unit")
