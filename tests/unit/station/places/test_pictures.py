"""Pictures described ahead of time give localisation the same bits as pictures described when they are needed."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest

from station.places.localisation.described_pictures import DescribedPictures
from station.vision.features import FeatureExtractor, extract_encoded
from tests.support.walls import camera_at, picture

PICTURES = [picture(1, camera_at(x)) for x in (-0.5, 0.0, 0.5)]
NO_PICTURE = b"cut short"


@pytest.fixture(scope="module")
def described() -> DescribedPictures:
    pictures = DescribedPictures()
    for encoded in (*PICTURES, NO_PICTURE):
        pictures.describe(encoded)
    return pictures


def test_what_was_written_is_read_bit_for_bit(described: DescribedPictures, tmp_path: Path) -> None:
    again = DescribedPictures()
    described.write(tmp_path / "pictures.npz")
    assert again.add(tmp_path / "pictures.npz")
    assert [path.name for path in tmp_path.iterdir()] == ["pictures.npz"]
    assert len(again) == 4
    extractor = FeatureExtractor()
    for encoded in (*PICTURES, NO_PICTURE):
        assert again.knows(encoded)
        direct, kept = extract_encoded(encoded, extractor), again.describe(encoded)
        assert np.array_equal(direct.uv_px, kept.uv_px)
        assert np.array_equal(direct.descriptors, kept.descriptors)
    assert len(again.describe(PICTURES[0])) > 100 and len(again.describe(NO_PICTURE)) == 0


def test_only_wanted_pictures_are_kept(described: DescribedPictures, tmp_path: Path) -> None:
    pictures = DescribedPictures()
    described.write(tmp_path / "pictures.npz")
    pictures.add(tmp_path / "pictures.npz")
    pictures.keep_only([PICTURES[1], b"another"])
    assert [pictures.knows(encoded) for encoded in PICTURES] == [False, True, False]


def damaged(file: bytes, how: str) -> bytes:
    middle = len(file) // 2
    if how == "bit":
        return file[:middle] + bytes([file[middle] ^ 1]) + file[middle + 1 :]
    if how == "cut":
        return file[:middle]
    if how == "empty":
        return b""
    arrays = dict(np.load(io.BytesIO(file)))
    if how == "version":
        arrays["described_by"] = np.array("another version of the library")
    elif how == "short":
        arrays["uv_px"] = arrays["uv_px"][:-1]
    else:
        del arrays["count"]
    out = io.BytesIO()
    np.savez(out, **arrays)
    return out.getvalue()


@pytest.mark.parametrize("how", ["bit", "cut", "empty", "version", "short", "missing"])
def test_nothing_is_taken_from_a_file_that_is_not_sound(described: DescribedPictures, how: str, tmp_path: Path) -> None:
    path = tmp_path / "pictures.npz"
    described.write(path)
    path.write_bytes(damaged(path.read_bytes(), how))
    pictures = DescribedPictures()
    assert not pictures.add(path) and not pictures.add(tmp_path / "none.npz")
    assert len(pictures) == 0


def test_the_file_is_what_numpy_reads(described: DescribedPictures, tmp_path: Path) -> None:
    path = tmp_path / "pictures.npz"
    described.write(path)
    with np.load(path, allow_pickle=False) as arrays:
        assert set(arrays) == {"described_by", "digest", "count", "uv_px", "descriptors"}
        assert arrays["uv_px"].shape == (arrays["count"].sum(), 2) and arrays["digest"].shape == (4, 32)
        assert np.array_equal(arrays["descriptors"][: arrays["count"][0]], described.describe(PICTURES[0]).descriptors)
