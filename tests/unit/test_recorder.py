"""Recordings: what went in comes out, also when the end is missing."""

from __future__ import annotations

import errno
import logging
import math
import os
import threading
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import Writer

import station.recorder
from shared.calibration import REFERENCE_ROBOT
from shared.errors import DataError
from shared.mcap_recording import IMAGE_TOPIC, IMU_TOPIC, decode_image
from shared.messages import (
    CameraFrame,
    Capabilities,
    DriveApplied,
    ErrorNotice,
    Hello,
    ImuBatch,
    ImuSample,
    Status,
)
from station.datasets import open_dataset
from station.events import LogLine
from station.foxglove import encode_image
from station.place_report import PlaceReport
from station.places.answer import PlaceAnswer, PlaceCandidate
from station.recorder import Recorder, RecordingReport
from station.recovery import recover_recording
from station.retention import KeptRecording, to_remove
from station.slam.backend import SlamUpdate

HELLO = Hello(
    protocol=2,
    robot_id="r",
    name="R",
    session_id="first",
    capabilities=Capabilities(camera=True, imu=True, drive=True, pan_tilt=False, battery=False, hijack=False),
    calibration=REFERENCE_ROBOT,
)
START_NS = 1_403_715_283_262_142_976
JPEG = bytes(cv2.imencode(".jpg", np.random.default_rng(0).integers(0, 255, (48, 64), np.uint8))[1])


def frame(seq: int) -> CameraFrame:
    return CameraFrame(
        seq=seq,
        t_robot_ns=START_NS + seq * 50_000_000,
        exposure_ns=7,
        width=64,
        height=48,
        skipped=0,
        jpeg=JPEG + bytes([seq % 256]),
    )


def batch(first: int, count: int = 10) -> ImuBatch:
    return ImuBatch(
        first_sequence=first,
        samples=tuple(
            ImuSample(START_NS + n * 5_000_000 - 20_000_000, (0.1 * n, 1 / 3, -1e-9), (0.0, 1.0, 9.81))
            for n in range(first, first + count)
        ),
    )


def record(path: Path, frames: int = 20) -> RecordingReport:
    recorder = Recorder(path, min_free_bytes=0)
    recorder.on_connected(HELLO)
    for n in range(frames):
        recorder.on_imu(batch(10 * n))
        recorder.on_drive_applied(
            DriveApplied(t_robot_ns=START_NS + n * 50_000_000, linear=0.1 * (n // 5), angular=0.0)
        )
        recorder.on_frame(frame(n), n)
    recorder.on_status(Status(t_robot_ns=START_NS, uptime_s=1.0, temperatures_c={"cpu": 50.0}))
    recorder.on_gap(3)
    recorder.on_notice(ErrorNotice(code="device", message="x"))
    recorder.on_disconnected("over")
    return recorder.close()


def test_what_is_recorded_is_read_back_exactly(tmp_path: Path) -> None:
    report = record(tmp_path / "new" / "drive.mcap")
    assert (report.error, report.frames_dropped) == ("", 0)
    assert report.bytes == report.path.stat().st_size
    dataset = open_dataset(report.path)
    assert dataset.kind == "mcap" and dataset.calibration == REFERENCE_ROBOT
    frames = list(dataset.frames())
    assert [f.t_robot_ns for f in frames] == [START_NS + n * 50_000_000 for n in range(20)]
    assert [f.encoded for f in frames] == [frame(n).jpeg for n in range(20)]
    assert frames[3].exposure_ns == 7 and frames[3].grey().shape == (48, 64)
    imu = dataset.require_imu()
    expected = [s for n in range(20) for s in batch(10 * n).samples]
    assert imu.t_robot_ns.tolist() == [s.t_robot_ns for s in expected]
    assert imu.gyro_imu.tolist() == [list(s.gyro_imu) for s in expected]
    assert imu.accel_imu.tolist() == [list(s.accel_imu) for s in expected]
    assert [d.linear_m_s for d in dataset.drive()] == [0.0, 0.1, 0.2, pytest.approx(0.3)]


def test_samples_that_are_no_numbers_are_left_out_and_said(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    recorder = Recorder(tmp_path / "d.mcap", min_free_bytes=0)
    recorder.on_connected(HELLO)
    good = batch(0).samples
    broken = ImuSample(good[3].t_robot_ns, (0.0, math.nan, 0.0), good[3].accel_imu)
    recorder.on_imu(ImuBatch(first_sequence=0, samples=(*good[:3], broken, *good[4:])))
    recorder.close()
    imu = open_dataset(tmp_path / "d.mcap").require_imu()
    assert imu.t_robot_ns.tolist() == [s.t_robot_ns for s in (*good[:3], *good[4:])]
    assert np.isfinite(imu.gyro_imu).all() and "1 IMU samples are no numbers" in caplog.text


def test_a_range_of_frames_can_be_chosen(tmp_path: Path) -> None:
    record(tmp_path / "d.mcap")
    dataset = open_dataset(tmp_path / "d.mcap", first=4, last=10, step=3)
    assert [f.encoded[-1] for f in dataset.frames()] == [4, 7, 10]
    assert [f.index for f in dataset.frames()] == [0, 1, 2]


def test_foxglove_finds_schemas_and_index(tmp_path: Path) -> None:
    record(tmp_path / "d.mcap")
    with (tmp_path / "d.mcap").open("rb") as file:
        summary = make_reader(file).get_summary()
        assert summary is not None and summary.statistics is not None
        names = {c.topic: summary.schemas[c.schema_id] for c in summary.channels.values()}
        assert (names[IMAGE_TOPIC].name, names[IMAGE_TOPIC].encoding) == ("foxglove.CompressedImage", "protobuf")
        assert b"foxglove/CompressedImage.proto" in names[IMAGE_TOPIC].data
        assert names[IMU_TOPIC].encoding == "jsonschema"
        assert msgspec.json.decode(names[IMU_TOPIC].data)["type"] == "object"
        for _, channel, message in make_reader(file).iter_messages(topics=["/robot/status", "/camera/calibration"]):
            assert channel.message_encoding == "json" and msgspec.json.decode(message.data)


@given(t_ns=st.integers(-(2**62), 2**62), jpeg=st.binary(max_size=500))
def test_images_survive_their_protobuf(t_ns: int, jpeg: bytes) -> None:
    assert decode_image(encode_image(t_ns, jpeg)) == jpeg


@given(st.binary(max_size=60))
def test_what_is_no_image_message_is_refused_or_read(data: bytes) -> None:
    with suppress(DataError):
        assert isinstance(decode_image(data), bytes)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("rec") / "d.mcap"
    chunk, station.recorder.CHUNK_BYTES = station.recorder.CHUNK_BYTES, 4096
    try:
        record(path, frames=40)
    finally:
        station.recorder.CHUNK_BYTES = chunk
    return path.read_bytes()


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
    frames = list(dataset.frames()) if dataset.has_images else []
    assert [f.encoded for f in frames] == [frame(n).jpeg for n in range(len(frames))]
    assert len(frames) == len(dataset.frame_times_ns) >= 40 * fraction - 8
    times = dataset.require_imu().t_robot_ns.tolist()
    assert times == [s.t_robot_ns for n in range(40) for s in batch(10 * n).samples][: len(times)]


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
        frames = list(dataset.frames()) if dataset.has_images else []
    except DataError:
        return
    assert [f.encoded for f in frames] == [frame(n).jpeg for n in range(len(frames))]


def test_a_folder_that_cannot_be_written_is_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(DataError, match=r"cannot record to .*d\.mcap \(.*\); choose a folder"):
        Recorder(tmp_path / "file" / "d.mcap")


def test_a_full_disk_ends_the_recording_with_a_sentence(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.CRITICAL)
    recorder = Recorder(Path("/dev/full"), min_free_bytes=0)
    recorder.on_connected(HELLO)
    for n in range(200):
        recorder.on_frame(
            CameraFrame(seq=n, t_robot_ns=n, exposure_ns=0, width=1, height=1, skipped=0, jpeg=bytes(100_000)), n
        )
    report = recorder.close()
    assert "No space left on device" in report.error
    recorder.on_imu(batch(0))  # the link goes on as if nothing were
    assert recorder.close() == report


def test_a_disk_that_runs_full_ends_the_file_properly(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.CRITICAL)
    monkeypatch.setattr(station.recorder, "CHECK_DISK_NS", 0)
    recorder = Recorder(tmp_path / "d.mcap")
    monkeypatch.setattr(station.recorder, "_free_bytes", lambda path: 2**20)
    recorder.on_connected(HELLO)
    recorder.on_imu(batch(0))
    report = recorder.close()
    assert "are kept free; delete old recordings" in report.error
    with report.path.open("rb") as file:
        assert make_reader(file).get_summary() is not None


def test_closing_does_not_wait_for_a_disk_that_hangs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.CRITICAL)
    disk_works = threading.Event()
    monkeypatch.setattr(Writer, "start", lambda *_, **__: disk_works.wait(60))
    recorder = Recorder(tmp_path / "d.mcap", min_free_bytes=0)
    assert "did not take what waited within 0 s" in recorder.close(within_s=0.0).error
    disk_works.set()
    recorder.close()


def test_a_disk_that_is_too_far_behind_still_gets_what_was_accepted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.CRITICAL)
    disk_works = threading.Event()
    start = Writer.start

    def late_start(*arguments: Any, **more: Any) -> None:
        disk_works.wait(60)
        start(*arguments, **more)

    monkeypatch.setattr(Writer, "start", late_start)
    monkeypatch.setattr(station.recorder, "MAX_LATE", 200)
    recorder = Recorder(tmp_path / "d.mcap", min_free_bytes=0)
    recorder.on_connected(HELLO)
    n = 0
    while not recorder.error:
        recorder.on_imu(batch(10 * n))
        n += 1
    assert "messages behind" in recorder.error
    recorder.close(within_s=0.0)  # does not hang
    disk_works.set()
    report = recorder.close()
    with report.path.open("rb") as file:
        reader = make_reader(file)
        assert reader.get_summary() is not None
        assert sum(1 for _ in reader.iter_messages(topics=[IMU_TOPIC])) >= 190


def test_a_write_error_of_another_kind_is_told_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.CRITICAL)

    def unplugged(path: Path) -> int:
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(station.recorder, "CHECK_DISK_NS", 0)
    recorder = Recorder(tmp_path / "d.mcap")
    monkeypatch.setattr(station.recorder, "_free_bytes", unplugged)
    recorder.on_connected(HELLO)
    assert "Input/output error" in recorder.close().error


def test_what_is_called_closed_is_on_the_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    waited_for: list[int] = []
    monkeypatch.setattr(station.recorder.os, "fsync", lambda file: waited_for.append(os.fstat(file).st_size))
    report = record(tmp_path / "d.mcap")
    assert report.error == "" and waited_for[-1] == report.bytes


def test_a_disk_that_fails_at_the_very_end_is_told_with_what_may_be_lost(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.CRITICAL)
    now_ns = 0

    def fails(_: int) -> None:
        raise OSError(errno.EIO, "Input/output error")

    recorder = Recorder(tmp_path / "d.mcap", min_free_bytes=0, now_ns=lambda: now_ns)
    recorder.on_connected(HELLO)
    now_ns = 700_000_000
    recorder.on_imu(batch(0))
    monkeypatch.setattr(station.recorder.os, "fsync", fails)
    error = recorder.close().error
    assert "Input/output error" in error and "its last 0.7 s may be missing" in error


def test_a_recording_that_was_being_ended_says_both_reasons(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.CRITICAL)
    may_end = threading.Event()
    finish = Writer.finish

    def fails(writer: Writer) -> None:
        may_end.wait(60)
        finish(writer)
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(Writer, "finish", fails)
    monkeypatch.setattr(station.recorder, "MAX_LATE", 0)
    recorder = Recorder(tmp_path / "d.mcap", min_free_bytes=0)
    recorder.on_connected(HELLO)
    assert "messages behind" in recorder.error
    may_end.set()
    error = recorder.close().error
    assert "messages behind" in error and "Input/output error" in error


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


def test_another_run_of_the_robot_ends_what_is_read(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    recorder = Recorder(tmp_path / "d.mcap")
    recorder.on_connected(HELLO)
    recorder.on_imu(batch(0))
    recorder.on_connected(HELLO)  # the same run again: the link was cut
    recorder.on_imu(batch(10))
    recorder.on_connected(msgspec.structs.replace(HELLO, session_id="second"))
    recorder.on_imu(batch(1000))
    recorder.close()
    dataset = open_dataset(tmp_path / "d.mcap")
    assert len(dataset.require_imu()) == 20
    assert "restarted" in caplog.text
    assert not dataset.has_images


def test_a_full_disk_is_noticed_before_recording_begins(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="MiB are kept free; delete old recordings"):
        Recorder(tmp_path / "d.mcap", min_free_bytes=2**62)
    assert list(tmp_path.iterdir()) == []


def messages_of(path: Path, topic: str) -> list[dict[str, Any]]:
    with path.open("rb") as file:
        found = make_reader(file).iter_messages(topics=[topic])
        return [msgspec.json.decode(message.data) for _, _, message in found]


def test_what_the_station_decides_is_recorded_with_its_reasons(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "d.mcap", min_free_bytes=0)
    sofa = PlaceCandidate("place-1", "Sofa", 0.9)
    answer = PlaceAnswer(
        "known", sofa, 0.4, np.array([1.0, 2.0, 3.0]), START_NS, START_NS, 3, 40, (), "40 points agree"
    )
    lost = replace(answer, state="lost", place=None, distance=None, position_map=None, reason="carried")
    for one in (answer, lost):
        recorder.on_answer(PlaceReport("map-1", one, None, None, "found"))
    recorder.on_command("page", 0.1, -0.2, 300)
    T = np.eye(4)
    T[0, 3] = 0.5
    recorder.on_slam(SlamUpdate(START_NS, "tracking", "fine", T, 12, True))
    recorder.on_slam(SlamUpdate(START_NS + 1, "lost", "dark", None, 12, False))
    recorder.on_log(LogLine(1, 1.5e9, "warning", "hijack", "picked up"))
    path = recorder.close().path
    known, unknown = messages_of(path, "/place/answer")
    assert known["place"] == {"id": "place-1", "name": "Sofa", "probability": 0.9}
    assert (known["reason"], known["attempt"], known["map"]) == ("40 points agree", "found", "map-1")
    assert unknown["state"] == "lost" and "place" not in unknown and unknown["reason"] == "carried"
    command = {"driver": "page", "linear": 0.1, "angular": -0.2, "ttl_ms": 300}
    assert messages_of(path, "/drive/command") == [command]
    assert [m["state"] for m in messages_of(path, "/slam/state")] == ["tracking", "lost"]
    assert [m["pose"]["position"]["x"] for m in messages_of(path, "/slam/pose")] == [0.5]
    assert [(m["level"], m["message"]) for m in messages_of(path, "/station/log")] == [(3, "picked up")]


@settings(max_examples=25)
@given(fraction=st.floats(0, 1))
def test_a_cut_recording_gets_its_end_again(
    whole: bytes, tmp_path_factory: pytest.TempPathFactory, fraction: float
) -> None:
    path = tmp_path_factory.getbasetemp() / "recovered.mcap"
    path.write_bytes(whole[: int(fraction * len(whole))])
    try:
        readable = [f.encoded for f in open_dataset(path).frames()]
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
        assert summary.statistics.message_count == recovery.messages and str(path) in str(recovery)
    if readable:
        assert [f.encoded for f in open_dataset(path).frames()] == readable
    assert recover_recording(path) is None
    assert not path.with_name(".recovered.mcap.recovered").exists()


def test_the_oldest_recordings_go_first() -> None:
    kept = [KeptRecording(str(day), day * 86_400.0, 10) for day in range(5)]
    now_s = 5 * 86_400.0
    assert to_remove(kept, 0, 0, now_s) == []
    assert [r.drive_id for r in to_remove(kept, 25, 0, now_s)] == ["0", "1", "2"]
    assert [r.drive_id for r in to_remove(kept, 0, 3.5 * 86_400, now_s)] == ["0", "1"]
    assert [r.drive_id for r in to_remove(kept, 45, 4.5 * 86_400, now_s)] == ["0"]
