"""Files that somebody made to harm: one sentence, and no more memory than a file of their size may take."""

from __future__ import annotations

from pathlib import Path

import pytest

from station.maps.store import MapStore
from tests.support import hostile_files as hostile
from tests.support.child_memory import Reading, read_in_child

ALLOWED_MB = 300.0
GB = 1024**3
READERS_OF_RECORDINGS = (
    "station.datasets:open_dataset",
    "robot.devices.recorded.recording:open_recording",
    "station.recordings.check:check_recording",
    "station.recordings.recovery:recover_recording",
)


def restore(root: Path, backup: Path) -> object:
    from station.maps.backup import restore_backup

    return restore_backup(MapStore(root), backup)


def said(reading: Reading) -> str:
    assert reading.grown_mb < ALLOWED_MB, f"{reading.grown_mb:.0f} MB: {reading}"
    return reading.refused or reading.result


@pytest.mark.parametrize(("compression", "size", "claimed"), [("zstd", GB, GB), ("lz4", GB // 2, 1000)])
@pytest.mark.parametrize("reader", READERS_OF_RECORDINGS)
def test_a_recording_that_unpacks_to_a_gigabyte_is_refused(
    reader: str, compression: str, size: int, claimed: int, tmp_path: Path
) -> None:
    packed = {"zstd": hostile.zeros_in_zstd, "lz4": hostile.zeros_in_lz4}[compression](size)
    path = hostile.mcap_of_chunks(tmp_path / "bomb.mcap", packed, compression, claimed)
    assert str(path) in said(read_in_child(reader, path))


def test_chunks_that_are_small_each_do_not_unpack_without_end(tmp_path: Path) -> None:
    path = hostile.mcap_of_equal_frames(tmp_path / "bomb.mcap", chunks=20)
    assert path.stat().st_size < 1_000_000
    assert "/robot/hello" in said(read_in_child("station.datasets:open_dataset", path))


def test_a_hole_in_a_backup_is_not_unpacked(tmp_path: Path) -> None:
    backup = hostile.backup_with_hole(tmp_path / "backup.tar", 6 * GB)
    assert backup.stat().st_size < 2000
    told = said(read_in_child(f"{__name__}:restore", tmp_path / "store", backup))
    assert "claims 6442450944 bytes" in told


def test_headers_one_in_another_end_a_backup_with_a_sentence(tmp_path: Path) -> None:
    backup = hostile.backup_of_nested_headers(tmp_path / "backup.tar", 3000)
    assert "is no backup" in said(read_in_child(f"{__name__}:restore", tmp_path / "store", backup))


def test_arrays_that_unpack_to_gigabytes_are_refused(tmp_path: Path) -> None:
    folder = hostile.navigation_with_packed_observations(tmp_path / "nav", GB // 4)
    told = said(read_in_child("station.files.navigation_folder:load_navigation", folder))
    assert "observations.npz" in told and "too much for its size" in told


def test_a_calibration_of_aliases_is_refused(tmp_path: Path) -> None:
    path = hostile.calibration_of_aliases(tmp_path / "camera.yaml", 27)
    assert "alias" in said(read_in_child("shared.sensor_yaml:read_camera", path))


def decode(path: Path) -> object:
    from station.model.frames import ImageFrame

    return ImageFrame(0, 0, 0, path.read_bytes(), path.name).bgr().shape


def to_jpeg(path: Path) -> object:
    from robot.devices.recorded.images import to_jpeg

    return len(to_jpeg(path.read_bytes(), path))


@pytest.mark.parametrize("reader", ["decode", "to_jpeg"])
def test_a_picture_of_many_pixels_is_not_decoded(reader: str, tmp_path: Path) -> None:
    (tmp_path / "large.png").write_bytes(hostile.empty_png(20_000, 20_000))
    told = said(read_in_child(f"{__name__}:{reader}", tmp_path / "large.png"))
    assert "large.png has 20000x20000 pixels" in told
