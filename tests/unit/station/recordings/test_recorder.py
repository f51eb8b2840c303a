"""Recordings: what went in comes out, and a disk that fails is told."""

from __future__ import annotations

import errno
import logging
import math
import os
import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer

import station.recordings.recorder
from shared.calibration import REFERENCE_HEAD, REFERENCE_ROBOT
from shared.errors import DataError
from shared.mcap_recording import IMAGE_TOPIC, IMU_TOPIC
from shared.message_codec import decode_robot_message, encode_message
from shared.messages import (
    CameraFrame,
    Depth,
    DriveApplied,
    ImuBatch,
    ImuSample,
)
from station.datasets import open_dataset
from station.events import LogLine
from station.model.place_answer import PlaceAnswer, PlaceCandidate, PlaceReport, RoomCandidate
from station.model.slam_update import SlamUpdate
from station.recordings.recorder import MAX_WAITING_FRAMES, Recorder
from tests.support.datasets import frames_of, imu_of
from tests.support.memory import grown_bytes
from tests.support.recordings import HELLO, START_NS, batch, frame, record


def test_what_is_recorded_is_read_back_exactly(tmp_path: Path) -> None:
    report = record(tmp_path / "new" / "drive.mcap")
    assert (report.error, report.frames_dropped) == ("", 0)
    assert report.bytes == report.path.stat().st_size
    dataset = open_dataset(report.path)
    assert dataset.kind == "mcap" and dataset.calibration == REFERENCE_ROBOT
    frames = list(frames_of(dataset))
    assert [f.t_robot_ns for f in frames] == [START_NS + n * 50_000_000 for n in range(20)]
    assert [f.encoded for f in frames] == [frame(n).jpeg for n in range(20)]
    assert frames[3].exposure_ns == 7 and frames[3].grey().shape == (48, 64)
    imu = imu_of(dataset)
    expected = [s for n in range(20) for s in batch(10 * n).samples]
    assert imu.t_robot_ns.tolist() == [s.t_robot_ns for s in expected]
    assert imu.gyro_imu.tolist() == [list(s.gyro_imu) for s in expected]
    assert imu.accel_imu.tolist() == [list(s.accel_imu) for s in expected]
    assert [d.linear_m_s for d in dataset.drive] == [0.0, 0.1, 0.2, pytest.approx(0.3)]


def test_where_the_head_looks_is_recorded_in_every_report_while_it_turns(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "drive.mcap", min_free_bytes=0)
    recorder.on_connected(HELLO)
    for n in range(6):
        pan = 0.1 * min(n, 3)
        applied = DriveApplied(t_robot_ns=START_NS + n, linear=0.0, angular=0.0, pan=pan, tilt=-pan)
        recorder.on_drive_applied(applied)
        recorder.on_frame(frame(n), n)
    recorder.close()
    dataset = open_dataset(tmp_path / "drive.mcap")
    assert [(d.t_robot_ns - START_NS, d.pan_rad, d.tilt_rad) for d in dataset.drive] == [
        (n, pytest.approx(0.1 * n), pytest.approx(-0.1 * n)) for n in range(4)
    ]
    assert dataset.calibration.head == REFERENCE_HEAD


def test_samples_that_are_no_numbers_are_left_out_and_said(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    recorder = Recorder(tmp_path / "d.mcap", min_free_bytes=0)
    recorder.on_connected(HELLO)
    good = batch(0).samples
    broken = ImuSample(good[3].t_robot_ns, (0.0, math.nan, 0.0), good[3].accel_imu)
    recorder.on_imu(ImuBatch(first_sequence=0, samples=(*good[:3], broken, *good[4:])))
    recorder.close()
    imu = imu_of(open_dataset(tmp_path / "d.mcap"))
    assert imu.t_robot_ns.tolist() == [s.t_robot_ns for s in (*good[:3], *good[4:])]
    assert np.isfinite(imu.gyro_imu).all() and "1 IMU samples are no numbers" in caplog.text


def test_a_range_of_frames_can_be_chosen(tmp_path: Path) -> None:
    record(tmp_path / "d.mcap")
    dataset = open_dataset(tmp_path / "d.mcap", first=4, last=10, step=3)
    assert [f.encoded[-1] for f in frames_of(dataset)] == [4, 7, 10]
    assert [f.index for f in frames_of(dataset)] == [0, 1, 2]


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
    monkeypatch.setattr(station.recordings.recorder, "CHECK_DISK_NS", 0)
    recorder = Recorder(tmp_path / "d.mcap")
    monkeypatch.setattr(station.recordings.recorder, "_free_bytes", lambda path: 2**20)
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


def late_disk(monkeypatch: pytest.MonkeyPatch) -> threading.Event:
    """Nothing is written before this is set."""
    works, start = threading.Event(), Writer.start

    def late_start(*arguments: Any, **more: Any) -> None:
        works.wait(60)
        start(*arguments, **more)

    monkeypatch.setattr(Writer, "start", late_start)
    return works


def test_depth_that_the_disk_does_not_take_is_dropped_as_pictures_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    disk_works = late_disk(monkeypatch)
    recorder = Recorder(tmp_path / "d.mcap", min_free_bytes=0)
    recorder.on_connected(HELLO)
    for n in range(300):
        recorder.on_depth(Depth(seq=n, t_robot_ns=n, png=bytes(1000)))
    assert recorder.report.frames_dropped == 300 - MAX_WAITING_FRAMES
    disk_works.set()
    while recorder.report.messages < MAX_WAITING_FRAMES and not recorder.error:
        time.sleep(0.01)  # until the disk is not behind any more
    recorder.on_depth(Depth(seq=300, t_robot_ns=300, png=bytes(1000)))
    assert recorder.close().frames_dropped == 300 - MAX_WAITING_FRAMES


def test_a_disk_that_is_too_far_behind_still_gets_what_was_accepted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.CRITICAL)
    disk_works = late_disk(monkeypatch)
    monkeypatch.setattr(station.recordings.recorder, "MAX_LATE", 200)
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


def test_what_waits_for_a_disk_is_packed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    disk_works = late_disk(monkeypatch)
    recorder = Recorder(tmp_path / "d.mcap", min_free_bytes=0)

    def record(count: int) -> None:
        for n in range(count):
            samples = decode_robot_message(encode_message(batch(3 * n, 3)))
            assert isinstance(samples, ImuBatch)
            recorder.on_imu(samples)
            recorder.on_command("page", 0.1, -0.2, n)

    assert grown_bytes(lambda: record(10), lambda: record(1000)) < 1_000_000
    disk_works.set()
    assert recorder.close().messages == 4 * 1010


def test_a_write_error_of_another_kind_is_told_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.CRITICAL)

    def unplugged(path: Path) -> int:
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(station.recordings.recorder, "CHECK_DISK_NS", 0)
    recorder = Recorder(tmp_path / "d.mcap")
    monkeypatch.setattr(station.recordings.recorder, "_free_bytes", unplugged)
    recorder.on_connected(HELLO)
    assert "Input/output error" in recorder.close().error


def test_what_cannot_be_encoded_ends_the_recording_with_a_sentence(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.CRITICAL)
    recorder = Recorder(tmp_path / "d.mcap")
    recorder.on_imu(batch(0, 3))
    recorder.on_log(LogLine(1, 1.5e9, "warning", "map", "cannot be read: /data/\udcff"))
    report = recorder.close()
    assert "an error of the recorder" in report.error and report.messages >= 3


def test_what_is_called_closed_is_on_the_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    waited_for: list[int] = []
    monkeypatch.setattr(station.recordings.recorder.os, "fsync", lambda file: waited_for.append(os.fstat(file).st_size))
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
    monkeypatch.setattr(station.recordings.recorder.os, "fsync", fails)
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
    monkeypatch.setattr(station.recordings.recorder, "MAX_LATE", 0)
    recorder = Recorder(tmp_path / "d.mcap", min_free_bytes=0)
    recorder.on_connected(HELLO)
    assert "messages behind" in recorder.error
    may_end.set()
    error = recorder.close().error
    assert "messages behind" in error and "Input/output error" in error


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
    assert len(imu_of(dataset)) == 20
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
        "known", sofa, 0.4, np.array([1.0, 2.0, 3.0]), START_NS, START_NS, 3, 40, (), "40 points agree",
        room=RoomCandidate("room-1", "Lounge", 0.95),
    )  # fmt: skip
    lost = replace(answer, state="lost", place=None, distance=None, position_map=None, reason="carried", room=None)
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
    assert known["room"] == {"id": "room-1", "name": "Lounge", "probability": 0.95}
    assert (
        unknown["state"] == "lost"
        and "place" not in unknown
        and "room" not in unknown
        and unknown["reason"] == "carried"
    )
    command = {"driver": "page", "linear": 0.1, "angular": -0.2, "ttl_ms": 300}
    assert messages_of(path, "/drive/command") == [command]
    assert [m["state"] for m in messages_of(path, "/slam/state")] == ["tracking", "lost"]
    assert [m["pose"]["position"]["x"] for m in messages_of(path, "/slam/pose")] == [0.5]
    assert [(m["level"], m["message"]) for m in messages_of(path, "/station/log")] == [(3, "picked up")]


def test_a_recording_of_hours_takes_no_more_memory_and_has_its_whole_index(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(station.recordings.recorder, "CHUNK_BYTES", 1)  # an hour's worth of chunks at once
    recorder = Recorder(tmp_path / "d.mcap", min_free_bytes=0)

    def record_for_long() -> None:
        until_count = recorder.report.messages + 3000
        for number in range(3000):
            recorder.on_command("page", 0.1, 0.0, number)
        while recorder.report.messages < until_count:
            time.sleep(0.01)

    assert grown_bytes(record_for_long, record_for_long) < 200_000
    path = recorder.close().path
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None and summary.statistics is not None
    assert len(summary.chunk_indexes) == summary.statistics.chunk_count >= 6000
    assert [m["ttl_ms"] for m in messages_of(path, "/drive/command")] == 2 * list(range(3000))
