"""What a recording's messages may not be."""

from __future__ import annotations

import base64
import json
import math
import struct
from pathlib import Path
from typing import Any

import msgspec
import pytest
import zstandard
from mcap.opcode import Opcode
from mcap.writer import Writer

from shared.errors import DataError
from shared.mcap_recording import DRIVE_TOPIC, FRAME_TOPIC, HELLO_TOPIC, McapContent, mcap_images, recorded_pictures
from tests.support.hostile_files import mcap_of_chunks
from tests.support.recordings import HELLO, finish


def recording_of(path: Path, topic: str, data: bytes) -> Path:
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        writer.add_message(writer.register_channel(topic, "json", 0), 1, data, 1)
        finish(writer)
    return path


def hello(**calibration: Any) -> bytes:
    content = msgspec.msgpack.decode(msgspec.msgpack.encode(HELLO))
    content["calibration"] |= calibration
    packed = base64.b64encode(msgspec.msgpack.encode(content)).decode()
    return json.dumps({"msgpack_base64": packed}).encode()


def stamped(seconds: object, **content: Any) -> bytes:
    return json.dumps({"timestamp": {"sec": seconds, "nsec": 0}, **content}).encode()


DEEP = json.dumps({"msgpack_base64": base64.b64encode(b"\x81\xa1a" * 200_000 + b"\xc0").decode()}).encode()


def test_a_hello_that_nests_without_end_is_damage_and_no_traceback(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="cannot be read"):
        McapContent(recording_of(tmp_path / "a.mcap", HELLO_TOPIC, DEEP))


@pytest.mark.parametrize(
    ("topic", "data"),
    [
        (HELLO_TOPIC, hello(gravity=math.nan)),
        (HELLO_TOPIC, hello(gravity=math.inf)),
        (FRAME_TOPIC, stamped(10**30, exposure_ns=0)),
        (FRAME_TOPIC, stamped(1.0e300, exposure_ns=0)),
        (FRAME_TOPIC, stamped("0123456789", exposure_ns=0)),
        (FRAME_TOPIC, stamped(1, exposure_ns=10**30)),
        (FRAME_TOPIC, b"{}"),
        (FRAME_TOPIC, b'{"timestamp": [1]}'),
        (DRIVE_TOPIC, stamped(1, linear="nan", angular=0.0)),
        (DRIVE_TOPIC, stamped(1, linear=0.0, angular="inf")),
        (FRAME_TOPIC, b'{"a":' * 100_000),
    ],
)
def test_what_is_no_time_velocity_or_calibration_is_refused(topic: str, data: bytes, tmp_path: Path) -> None:
    with pytest.raises(DataError, match=topic if len(data) < 100_000 else "not JSON"):
        McapContent(recording_of(tmp_path / "a.mcap", topic, data))


@pytest.mark.parametrize("data", [b"{}", b"[]", b'{"timestamp": 1}', stamped(10**30)])
def test_a_replay_of_what_is_no_frame_ends_in_a_sentence(data: bytes, tmp_path: Path) -> None:
    with pytest.raises(DataError):
        list(recorded_pictures(recording_of(tmp_path / "a.mcap", FRAME_TOPIC, data)))


def test_a_recording_that_other_tools_packed_with_zstd_is_read(tmp_path: Path) -> None:
    content = McapContent(recording_of(tmp_path / "a.mcap", HELLO_TOPIC, hello()))  # zstd is the writer's default
    assert content.hello == HELLO and not list(mcap_images(tmp_path / "a.mcap"))


@pytest.mark.parametrize("kind", [Opcode.MESSAGE, Opcode.STATISTICS])
def test_a_record_longer_than_its_chunk_is_damage_and_no_traceback(kind: Opcode, tmp_path: Path) -> None:
    content = struct.pack("<BQ", kind, 2**64 - 1)
    path = mcap_of_chunks(tmp_path / "a.mcap", zstandard.compress(content), "zstd", len(content))
    content = McapContent(path)  # read up to there
    assert content.hello is None and not list(mcap_images(path))
