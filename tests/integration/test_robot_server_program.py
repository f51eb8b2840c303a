"""The program robot-server: one sentence on bad input, a clean end on signals, real recordings over TCP."""

from __future__ import annotations

import asyncio
import os
import signal
import socket
import subprocess
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import cv2
import numpy as np
import pytest

from robot.app import open_devices
from robot.config import RecordedConfig, RobotConfig
from shared.errors import DeviceUnavailable
from station.datasets import open_dataset
from station.recordings.recorder import Recorder
from station.robots.link import RobotLink
from tests.support.datasets import frames_of, imu_of
from tests.support.link import linked, until
from tests.support.paths import ROOT

FLIGHT = ROOT.parent / "shared" / "data" / "euroc_v1_01_flight"
CAMERA_YAML = "resolution: [64, 48]\nintrinsics: [60.0, 60.0, 32.0, 24.0]\nrate_hz: 30\n"


def image_folder(path: Path, frames: int = 10) -> Path:
    path.mkdir()
    (path / "camera.yaml").write_text(CAMERA_YAML)
    for k in range(frames):
        cv2.imwrite(str(path / f"frame-{k:03d}.jpg"), np.full((48, 64, 3), k, np.uint8))
    return path


@asynccontextmanager
async def robot_server(*options: str) -> AsyncIterator[tuple[asyncio.subprocess.Process, int]]:
    process = await asyncio.create_subprocess_exec(
        sys.executable,
        "-m",
        "robot.main",
        *options,
        "--port",
        "0",
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    assert process.stdout is not None
    try:
        line = (await asyncio.wait_for(process.stdout.readline(), 60)).decode()
        yield process, int(line.rsplit(":", 1)[1])
    finally:
        if process.returncode is None:
            process.kill()
        await process.communicate()


def run_to_end(*options: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "robot.main", *options],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=60,
        env={**os.environ, "NO_COLOR": "1", "TERM": "dumb"},
    )


@pytest.mark.usefixtures("started_by_a_shell")
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP])
async def test_a_signal_ends_it_cleanly_and_the_stations_are_told(tmp_path: Path, number: int) -> None:
    dataset = str(image_folder(tmp_path / "d"))
    async with (
        robot_server("--devices", "recorded", "--dataset", dataset) as (process, port),
        linked(port) as (_, notes),
    ):
        process.send_signal(number)
        assert await asyncio.wait_for(process.wait(), 20) == 0
        await until(lambda: notes.reasons)
        assert "shutting down" in notes.reasons[0]
        assert process.stderr is not None
        said = (await process.stderr.read()).decode()
        assert said.count("\n") == 1 and "holds no IMU samples" in said


def test_a_port_in_use_is_one_sentence(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        dataset = str(image_folder(tmp_path / "d"))
        done = run_to_end("--devices", "recorded", "--dataset", dataset, "--port", str(port))
    assert done.returncode == 1
    assert done.stderr == (
        f"robot-server: cannot listen on 127.0.0.1:{port} (Address already in use);"
        " stop the program that uses the port or choose another with --port\n"
    )


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--devices", "recorded"], "needs --dataset DIR"),
        (["--devices", "recorded", "--dataset", "/nowhere"], "/nowhere does not exist"),
        (["--devices", "recorded", "--dataset", ".", "--config", "/nowhere.toml"], "/nowhere.toml cannot be read"),
        (["--devices", "recorded", "--dataset", ".", "--port", "99999"], "server.port"),
        (["--devices", "recorded", "--dataset", ".", "--host", "no.such.host.invalid"], "give an address"),
        (["--devices", "recorded", "--dataset", ".", "--speed", "0"], "recorded.speed"),
    ],
)
def test_bad_input_is_one_sentence(options: list[str], said: str) -> None:
    done = run_to_end(*options) if "--port" in options else run_to_end(*options, "--port", "0")
    assert done.returncode == 1
    assert said in done.stderr
    assert done.stderr.count("\n") == 1 and "Traceback" not in done.stderr


async def test_the_end_of_a_recording_is_told_and_the_robot_stays(tmp_path: Path) -> None:
    dataset = str(image_folder(tmp_path / "d", frames=8))
    async with (
        robot_server("--devices", "recorded", "--dataset", dataset, "--speed", "20") as (_, port),
        linked(port) as (link, notes),
    ):
        await until(lambda: notes.notices)
        assert notes.notices[0].code == "end_of_recording"
        assert link.state.frames + link.state.frames_skipped == 8  # the notice comes after all data
        assert link.state.connected


@pytest.mark.skipif(not FLIGHT.is_dir(), reason="../shared/data/euroc_v1_01_flight is not here")
async def test_a_real_flight_streams_whole_and_its_recording_is_the_flight_again(tmp_path: Path) -> None:
    flight = open_dataset(FLIGHT)
    recorder = Recorder(tmp_path / "flight.mcap", min_free_bytes=0)
    async with robot_server("--devices", "recorded", "--dataset", str(FLIGHT), "--speed", "4") as (_, port):
        link = RobotLink("127.0.0.1", port, recorder)
        task = asyncio.create_task(link.run())
        await until(lambda: link.state.notice is not None)
        state = link.state
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
    assert recorder.close().error == ""
    assert (state.imu_samples, state.imu_lost) == (1391, 0)
    assert state.frames + state.frames_skipped == 90
    recorded = open_dataset(tmp_path / "flight.mcap")
    assert imu_of(recorded).t_robot_ns.tolist() == imu_of(flight).t_robot_ns.tolist()
    assert imu_of(recorded).gyro_imu.tolist() == imu_of(flight).gyro_imu.tolist()
    assert imu_of(recorded).accel_imu.tolist() == imu_of(flight).accel_imu.tolist()
    assert set(recorded.frame_times_ns.tolist()) <= set(flight.frame_times_ns.tolist())
    assert recorded.calibration == flight.calibration
    if not state.frames_skipped:  # a busy machine may skip some; what came is whole
        assert recorded.frame_times_ns.tolist() == flight.frame_times_ns.tolist()
    first = next(iter(frames_of(recorded)))
    original = {int(f.t_robot_ns): f for f in frames_of(flight)}[first.t_robot_ns]
    difference = first.grey().astype(int) - original.grey().astype(int)
    assert np.abs(difference).mean() < 2.0  # JPEG at quality 95


def test_a_missing_package_is_named_with_its_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "robot.devices.recorded", raising=False)
    monkeypatch.setitem(sys.modules, "robot.devices.recorded.recording", None)  # as if it could not be imported
    with pytest.raises(DeviceUnavailable, match=r"--devices recorded needs .*\[simulation\]"):
        open_devices("recorded", RobotConfig(recorded=RecordedConfig(dataset="x")))
