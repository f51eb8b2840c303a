"""Spilled arrays come back bit for bit, whatever the disk does."""

from __future__ import annotations

import resource
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

import shared.disk
import station.files.spill
from station.files.spill import Spill

KINDS = st.sampled_from([np.uint8, np.int64, np.float64])
SHAPES = arrays.array_shapes(min_dims=1, max_dims=2, min_side=0, max_side=30)


def resident_bytes() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()


@given(given_arrays=st.lists(KINDS.flatmap(lambda kind: arrays.arrays(kind, SHAPES)), max_size=12))
def test_every_array_comes_back_and_cannot_be_written(given_arrays: list[np.ndarray]) -> None:
    spill = Spill(file_bytes=1024)  # many chunks, and arrays that are larger than one
    kept = [spill.put(array) for array in given_arrays]
    for array, back in zip(given_arrays, kept, strict=True):
        assert back.dtype == array.dtype and back.shape == array.shape
        np.testing.assert_array_equal(back, array)
        assert not array.nbytes or not back.flags.writeable


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="needs /proc to see the memory")
def test_spilled_arrays_take_no_memory() -> None:
    spill = Spill(file_bytes=2**23, resident_bytes=2**21)
    rng = np.random.default_rng(0)
    kept = [spill.put(rng.integers(0, 256, 2**20, dtype=np.uint8)) for _ in range(4)]
    before = resident_bytes()
    kept += [spill.put(rng.integers(0, 256, 2**20, dtype=np.uint8)) for _ in range(64)]
    assert resident_bytes() - before < 16 * 2**20
    again = np.random.default_rng(0)
    assert all((array == again.integers(0, 256, 2**20, dtype=np.uint8)).all() for array in kept)


def test_without_a_disk_arrays_stay_in_memory(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(shared.disk, "_ON_DISK", tmp_path / "none")
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "none"))
    array = np.arange(5)
    spill = Spill()
    assert spill.put(array) is array and spill.put(array) is array


def test_what_others_need_of_the_disk_is_left_to_them(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(station.files.spill, "KEPT_FREE_BYTES", 2**62)
    array = np.arange(5)
    assert Spill().put(array) is array


def test_a_disk_that_fills_up_costs_nothing_that_is_there() -> None:
    spill = Spill(file_bytes=4096)
    first = spill.put(np.arange(100))
    limit = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (8192, limit[1]))
    try:
        large = np.arange(10_000)
        assert spill.put(large) is large
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limit)
    assert (first == np.arange(100)).all()
