"""Recordings that were cut or damaged: what is whole is read, recovered, and the rest told."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import lz4.frame
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from typer.testing import CliRunner

from shared.errors import DataError
from station.datasets import open_dataset
from station.main import app
from station.recordings.check import check_recording
from station.recordings.recorder import Recorder
from station.recordings.recovery import recover_recording
from tests.support.datasets import frames_of, imu_of
from tests.support.recordings import HELLO, batch, frame, messages_in, recorded_in_small_chunks


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    return recorded_in_small_chunks(tmp_path_factory.mktemp("rec") / "d.mcap")


@settings(max_examples=40, deadline=None)
@given(fraction=st.floats(0, 1))
def test_a_file_cut_anywhere_is_read_up_to_there(
    whole: bytes, tmp_path_factory: pytest.TempPathFactory, fraction: float
) -> None:
    path = tmp_path_factory.getbasetemp() / "cut.mcap"
    path.write_bytes(whole[: int(fraction * len(whole))])
    if fraction < 0.2:  # perhaps not even the hello is there
        with suppress(DataError):
            open_dataset(path)
        return
    dataset = open_dataset(path)
    frames = list(frames_of(dataset)) if dataset.has_images else []
    assert [f.encoded for f in frames] == [frame(n).jpeg for n in range(len(frames))]
    assert len(frames) == len(dataset.frame_times_ns) >= 40 * fraction - 8
    times = imu_of(dataset).t_robot_ns.tolist()
    assert times == [s.t_robot_ns for n in range(40) for s in batch(10 * n).samples][: len(times)]


@pytest.mark.parametrize("content", [b"\xa7" * 100_000, b"a text, say\n" * 50, bytes(1_000_000), b"x"])
def test_a_file_of_something_else_is_called_no_recording(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "x.mcap"
    path.write_bytes(content)
    said = str(check_recording(path))
    assert "it is no recording" in said and "killed" not in said and "recover" not in said


@pytest.mark.parametrize("length", [0, 1, 8, 20])
def test_a_recording_that_was_cut_at_its_begin_is_still_called_one(whole: bytes, tmp_path: Path, length: int) -> None:
    path = tmp_path / "x.mcap"
    path.write_bytes(whole[:length])
    assert "it has no end" in str(check_recording(path))


@settings(max_examples=40, deadline=None)
@given(position=st.floats(0, 0.999), value=st.integers(1, 255))
def test_a_flipped_byte_never_gives_wrong_data(
    whole: bytes, tmp_path_factory: pytest.TempPathFactory, position: float, value: int
) -> None:
    damaged = bytearray(whole)
    damaged[int(position * len(whole))] ^= value
    path = tmp_path_factory.getbasetemp() / "flipped.mcap"
    path.write_bytes(damaged)
    try:
        dataset = open_dataset(path)
        frames = list(frames_of(dataset)) if dataset.has_images else []
    except DataError:
        return
    assert [f.encoded for f in frames] == [frame(n).jpeg for n in range(len(frames))]


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "not an MCAP file"),
        (b"\x89PNG\r\n\x1a\n", "not an MCAP file"),
        (b"\x89MCAP0\r\n", "only recordings made by"),
    ],
)
def test_what_is_no_recording_is_one_sentence(tmp_path: Path, content: bytes, said: str) -> None:
    (tmp_path / "x.mcap").write_bytes(content)
    with pytest.raises(DataError, match=said):
        open_dataset(tmp_path / "x.mcap")


def test_an_empty_recording_is_said(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "d.mcap")
    recorder.on_connected(HELLO)
    recorder.close()
    with pytest.raises(DataError, match="neither images nor IMU"):
        open_dataset(tmp_path / "d.mcap")


@settings(max_examples=25)
@given(fraction=st.floats(0, 1))
def test_a_cut_recording_gets_its_end_again(
    whole: bytes, tmp_path_factory: pytest.TempPathFactory, fraction: float
) -> None:
    path = tmp_path_factory.getbasetemp() / "recovered.mcap"
    path.write_bytes(whole[: int(fraction * len(whole))])
    try:
        readable = [f.encoded for f in frames_of(open_dataset(path))]
    except DataError:
        readable = []
    try:
        recovery = recover_recording(path)
    except DataError:
        assert readable == []
        return
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None and summary.statistics is not None
    if recovery is not None:
        assert recovery.inside == "" and recovery.original is None  # nothing but the end is missing
        assert summary.statistics.message_count == recovery.messages and str(path) in str(recovery)
    if readable:
        assert [f.encoded for f in frames_of(open_dataset(path))] == readable
    assert recover_recording(path) is None
    assert list(path.parent.glob("*recovered.mcap*")) == [path]


def test_a_look_at_every_byte_tells_whole_recordings_from_others(whole: bytes, tmp_path: Path) -> None:
    data = tmp_path / "data"
    path = data / "navigations" / "nav-1" / "recording.mcap"
    path.parent.mkdir(parents=True)
    path.write_bytes(whole)
    verify = ["recordings", "verify", "--data", str(data)]
    said = CliRunner().invoke(app, verify)
    assert said.exit_code == 0 and f"{path}: whole" in said.output
    path.write_bytes(whole[: len(whole) // 2])
    said = CliRunner().invoke(app, verify)
    assert said.exit_code == 1 and "it has no end" in said.output
    recovered = CliRunner().invoke(app, ["recordings", "recover", str(path)])
    assert recovered.exit_code == 0 and "recovered" in recovered.output
    assert CliRunner().invoke(app, verify).exit_code == 0
    assert "nothing was changed" in CliRunner().invoke(app, ["recordings", "recover", str(path)]).output


FRAME_MAGIC = b"\x04\x22\x4d\x18"  # of LZ4


@settings(max_examples=60, deadline=None)
@given(position=st.floats(0, 0.9999), bit=st.integers(0, 7))
def test_a_flipped_bit_is_found_or_changes_no_message(
    whole: bytes, tmp_path_factory: pytest.TempPathFactory, position: float, bit: int
) -> None:
    folder = tmp_path_factory.getbasetemp()
    sound, path = folder / "sound.mcap", folder / "bit.mcap"
    sound.write_bytes(whole)
    damaged = bytearray(whole)
    damaged[int(position * len(whole))] ^= 1 << bit
    path.write_bytes(damaged)
    if not check_recording(path).damage:
        assert messages_in(path) == messages_in(sound)


def test_a_chunk_whose_packing_has_no_end_is_damage_though_all_its_bytes_are_there(
    whole: bytes, tmp_path: Path
) -> None:
    """Other programs refuse to unpack it."""
    begin = whole.index(FRAME_MAGIC)
    chunk = lz4.frame.LZ4FrameDecompressor()
    chunk.decompress(whole[begin:])
    last = len(whole) - len(chunk.unused_data or b"") - 1  # of the frame's end mark
    assert whole[last - 3 : last + 1] == bytes(4)
    path = tmp_path / "bit.mcap"
    path.write_bytes(whole[: last - 3] + b"\x01" + whole[last - 2 :])  # as of one byte more
    assert check_recording(path).damage
