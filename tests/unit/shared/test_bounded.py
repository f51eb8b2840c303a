"""What is opened, how far it may unpack, and what is said otherwise."""

from __future__ import annotations

import errno
import io
import json
import os
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot.config import read_toml
from robot.devices.recorded.recording import open_recording
from shared.bounded import (
    FREE_BYTES,
    MAX_RATIO,
    Refused,
    Unpacking,
    in_pieces,
    open_file,
    parse_json,
    parse_toml,
    read_file,
    shown,
)
from shared.errors import ConfigError, DataError
from shared.recorded_files import asl_numbers
from shared.sensor_yaml import read_intrinsics_text, read_yaml
from station.config import load_config
from station.datasets import open_dataset
from station.files.ply import read_ply
from station.maps.address import address_of
from station.maps.backup import restore_backup
from station.maps.record_files import RecordFile, parse_record_name
from station.maps.store import MapStore
from station.recordings.check import check_recording
from station.recordings.recovery import recover_recording


def verify(path: Path) -> None:
    """What is said of it is a finding, no error."""
    raise DataError(check_recording(path).damage)


READERS: dict[str, Callable[[Path], object]] = {
    "drive.mcap": open_dataset,
    "drive.mp4": open_dataset,
    "played.mcap": open_recording,
    "played.avi": open_recording,
    "verified.mcap": verify,
    "recovered.mcap": recover_recording,
    "camera.yaml": read_yaml,
    "camera-intrinsics.txt": read_intrinsics_text,
    "data.csv": lambda path: list(asl_numbers(path, 1)),
    "cloud.ply": read_ply,
    "maps.tar": lambda path: restore_backup(MapStore(path.parent / "store"), path),
    "station.toml": load_config,
    "robot.toml": read_toml,
}


@pytest.mark.timeout(60)
@pytest.mark.parametrize("name", READERS)
def test_no_reader_waits_for_a_pipe(name: str, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / name)
    with pytest.raises((DataError, ConfigError), match="it is a pipe, no file"):
        READERS[name](tmp_path / name)


@pytest.mark.timeout(60)
@pytest.mark.parametrize("name", READERS)
def test_no_reader_reads_a_device(name: str, tmp_path: Path) -> None:
    (tmp_path / name).symlink_to("/dev/zero")
    with pytest.raises((DataError, ConfigError), match="it is a device, no file"):
        READERS[name](tmp_path / name)


def test_a_folder_and_what_is_missing_are_named_as_ever(tmp_path: Path) -> None:
    with pytest.raises(IsADirectoryError):
        open_file(tmp_path)
    with pytest.raises(FileNotFoundError):
        open_file(tmp_path / "none")


def test_a_file_is_read_up_to_its_limit(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"12345")
    assert read_file(path, 5) == b"12345"
    with pytest.raises(Refused, match="more than") as caught:
        read_file(path, 4)
    assert caught.value.errno == errno.EFBIG and caught.value.filename == path


def test_no_piece_is_larger_than_allowed() -> None:
    file = in_pieces(io.BytesIO(b"12345"), 4)
    assert file.read(4) == b"1234" and file.tell() == 4
    for size in (5, 2**70, -1):
        with pytest.raises(Refused):
            file.read(size)


def test_what_is_unpacked_is_counted_as_a_whole() -> None:
    unpacking = Unpacking(1000)
    unpacking.take(FREE_BYTES)
    unpacking.take(MAX_RATIO * 1000)
    with pytest.raises(Refused, match="too much for its size"):
        unpacking.take(1)


@pytest.mark.parametrize("parse", [parse_json, parse_toml])
def test_nesting_without_end_is_a_value_error(parse: Callable[[str], object]) -> None:
    with pytest.raises(ValueError, match="too deep"):
        parse(("a = " if parse is parse_toml else "") + "[" * 100_000)


@pytest.mark.parametrize(
    "text",
    [
        ".".join(["a"] * 16_000) + " = 1",
        f"[{'a . ' * 16_000}a]",
        '"a".' * 16_000 + "a = 1",
        '"a b".' * 16_000 + "a = 1",
        '"\\"".' * 16_000 + "a = 1",
        "'!'." * 16_000 + "a = 1",
        "x = {" + "a." * 99 + "a = 1}",
    ],
)
def test_a_key_of_parts_without_end_is_refused_before_it_is_read(text: str) -> None:
    with pytest.raises(ValueError, match="more than 32 parts"):
        parse_toml(text)


@given(st.lists(st.sampled_from(["a", "b-c", '"d.e"', "'f'"]), min_size=1, max_size=8), st.text("ab. '\"", max_size=60))
def test_keys_and_texts_of_usual_lengths_are_read(parts: list[str], text: str) -> None:
    written = json.dumps(text)  # a string of TOML, too
    assert parse_toml(f"{' . '.join(parts)} = 1") and parse_toml(f"a = {written}") == {"a": text}


def test_a_long_word_is_no_key() -> None:
    assert parse_toml(f"a = '{'x' * 900_000}'")["a"].count("x") == 900_000


def test_settings_that_nest_without_end_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "settings.toml"
    path.write_text("a = " + "[" * 100_000)
    for read in (load_config, read_toml):
        with pytest.raises(ConfigError, match="too deep"):
            read(path)


def test_a_message_shows_the_begin_of_a_value() -> None:
    assert shown("a" * 1000).startswith("'aaa") and len(shown("a" * 1000)) < 250
    assert "int" in shown(10**5000)
    assert shown([1, 2]) == "[1, 2]"


def test_a_message_shows_names_of_ours_whole() -> None:
    address = address_of(b"")
    record = RecordFile("m" * 100, 1_000_000, address)
    assert parse_record_name(record.name) == record
    for name in (f"blobs/{address[:2]}/{address}", record.name):
        assert shown(name) == repr(name)
