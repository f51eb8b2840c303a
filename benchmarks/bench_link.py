"""Soak of the robot link on loopback: 640x480 at 30 fps and IMU at 225 Hz, robot-server in a process of its own.

Three runs: steady; a station that stalls for 5 s; a link that is cut ten times while the robot is driven.

    python -m benchmarks.bench_link --minutes 10
"""

from __future__ import annotations

import asyncio
import logging
import subprocess
import sys
import tempfile
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import psutil
import typer

from benchmarks.result import FOLDER, RESULTS_HELP, Figure, Run
from shared.messages import CameraFrame, Depth, DriveApplied, ErrorNotice, Hello, ImuBatch, Status
from station.robots.link import RobotLink
from station.robots.link_state import LinkState
from tests.support.paths import ROOT

FRAME_RATE_HZ, IMU_RATE_HZ, LOOP_S = 30, 225, 10
WARM_UP_S = 12.0  # longer than the loop: all pictures are in the robot's cache then
STALL_S = 5.0
STALE_MS = 250.0
CUTS, CONNECTED_S, CUT_S = 10, 2.5, 1.5
BACK_WITHIN_MS = 2000.0  # asked


def write_dataset(root: Path, frame_rate_hz: float = FRAME_RATE_HZ) -> None:
    """Ten seconds of textured pictures (about 50 kB each) and IMU samples, as an ASL folder."""
    cam, imu = root / "mav0" / "cam0", root / "mav0" / "imu0"
    (cam / "data").mkdir(parents=True)
    imu.mkdir()
    (cam / "sensor.yaml").write_text(
        f"resolution: [640, 480]\nintrinsics: [500, 500, 320, 240]\nrate_hz: {frame_rate_hz:g}\n"
    )
    rng = np.random.default_rng(0)
    coarse = rng.integers(0, 255, (120, 160, 3), np.uint8)
    scene = cv2.resize(coarse, (1280, 960), interpolation=cv2.INTER_CUBIC)
    names = []
    for k in range(round(frame_rate_hz * LOOP_S)):
        t_ns = round(k * 1e9 / frame_rate_hz)
        picture = np.roll(scene, 4 * k, axis=1)[200:680, 200:840]
        cv2.imwrite(str(cam / "data" / f"{t_ns}.jpg"), picture, [cv2.IMWRITE_JPEG_QUALITY, 80])
        names.append(f"{t_ns},{t_ns}.jpg\n")
    (cam / "data.csv").write_text("".join(names))
    rows = [f"{round(k * 1e9 / IMU_RATE_HZ)},0.1,0.2,0.3,0,0,9.81\n" for k in range(IMU_RATE_HZ * LOOP_S)]
    (imu / "data.csv").write_text("".join(rows))


@dataclass
class Listener:
    """What a station saw."""

    link: RobotLink | None = None
    frames: list[tuple[int, float]] = field(default_factory=list)  # (arrival, latency ms)
    connected_ns: list[int] = field(default_factory=list)
    applied: list[tuple[int, float]] = field(default_factory=list)  # (arrival, m/s)
    begin_ns: int = 0

    def on_connected(self, hello: Hello) -> None:  # noqa: ARG002
        self.connected_ns.append(time.monotonic_ns())

    def on_calibration(self, hello: Hello) -> None: ...

    def on_disconnected(self, reason: str) -> None: ...

    def on_frame(self, frame: CameraFrame, t_station_ns: int) -> None:
        taken_ns = self.link.to_station_ns(frame.t_robot_ns) if self.link else None
        if taken_ns is not None and t_station_ns > self.begin_ns:
            self.frames.append((t_station_ns, (t_station_ns - taken_ns) * 1e-6))

    def on_imu(self, batch: ImuBatch) -> None: ...

    def on_gap(self, num_samples: int) -> None: ...

    def on_depth(self, depth: Depth) -> None: ...

    def on_drive_applied(self, applied: DriveApplied) -> None:
        self.applied.append((time.monotonic_ns(), applied.linear))

    def on_status(self, status: Status) -> None: ...

    def on_notice(self, notice: ErrorNotice) -> None: ...


class Wire:
    """A relay that can be cut: then its port is closed too."""

    def __init__(self, target_port: int) -> None:
        self._target_port = target_port
        self._server: asyncio.Server | None = None
        self._writers: list[asyncio.StreamWriter] = []
        self._tasks: set[asyncio.Task[None]] = set()
        self.port = 0

    async def mend(self) -> None:
        self._server = await asyncio.start_server(self._take, "127.0.0.1", self.port)
        self.port = self._server.sockets[0].getsockname()[1]

    def cut(self) -> None:
        if self._server is not None:
            self._server.close()
        for writer in self._writers:
            writer.transport.abort()
        self._writers.clear()

    async def _take(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        robot_reader, robot_writer = await asyncio.open_connection("127.0.0.1", self._target_port)
        self._writers += [writer, robot_writer]
        for source, sink in ((reader, robot_writer), (robot_reader, writer)):
            task = asyncio.create_task(self._relay(source, sink))
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)

    async def _relay(self, source: asyncio.StreamReader, sink: asyncio.StreamWriter) -> None:
        try:
            while data := await source.read(65536):
                sink.write(data)
                await sink.drain()
        except OSError:
            pass
        sink.transport.abort()


@dataclass(frozen=True)
class Row:
    """One line of the table."""

    name: str
    seconds: float
    state: LinkState
    frames: list[tuple[int, float]]
    cpu_s_per_min: float
    memory_mb: tuple[float, float]
    remark: str
    figures: tuple[Figure, ...] = ()  # what only this run measures

    def __str__(self) -> str:
        p50, p99, worst = np.percentile([latency for _, latency in self.frames], [50, 99, 100])
        state = self.state
        cells = (
            self.name,
            f"{self.seconds:.0f} s",
            f"{state.imu_samples} / {state.imu_lost}",
            f"{state.frames} / {state.frames_skipped}",
            f"{p50:.1f} / {p99:.1f} / {worst:.0f}",
            f"{self.cpu_s_per_min:.2f}",
            f"{self.memory_mb[0]:.1f} / {self.memory_mb[1]:.1f}",
            self.remark,
        )
        return f"| {' | '.join(cells)} |"


@asynccontextmanager
async def robot_server(dataset: Path) -> AsyncIterator[tuple[psutil.Process, int]]:
    options = ["--devices", "recorded", "--dataset", str(dataset), "--at-end", "loop", "--port", "0"]
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-m", "robot.main", *options, cwd=ROOT, stdout=subprocess.PIPE
    )
    assert process.stdout is not None
    try:
        line = (await asyncio.wait_for(process.stdout.readline(), 60)).decode()
        yield psutil.Process(process.pid), int(line.rsplit(":", 1)[1])
    finally:
        process.terminate()
        await process.wait()


@asynccontextmanager
async def station(port: int, name: str) -> AsyncIterator[tuple[RobotLink, Listener]]:
    listener = Listener()
    link = listener.link = RobotLink("127.0.0.1", port, listener, station_name=name)
    task = asyncio.create_task(link.run())
    try:
        while not link.state.connected:
            await asyncio.sleep(0.01)
        yield link, listener
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)


def cpu_s(process: psutil.Process) -> float:
    times = process.cpu_times()
    return float(times.user + times.system)


def megabytes(process: psutil.Process) -> float:
    return float(process.memory_info().rss) / 1e6


async def run_plain(dataset: Path, seconds: float, does_stall: bool) -> Row:
    """Steady, or with a station whose event loop stands still for 5 s in the middle."""
    async with robot_server(dataset) as (process, port), station(port, "bench") as (link, listener):
        await asyncio.sleep(WARM_UP_S)
        listener.begin_ns = begin_ns = time.monotonic_ns()
        cpu_begin_s, memory_begin = cpu_s(process), megabytes(process)
        remark = ""
        figures: tuple[Figure, ...] = ()
        if does_stall:
            await asyncio.sleep(seconds / 2)
            seen, skipped = len(listener.frames), link.state.frames_skipped
            time.sleep(STALL_S)  # on purpose: the station does nothing at all
            awake_ns = time.monotonic_ns()
            await asyncio.sleep(max(1.0, seconds / 2 - STALL_S))
            stale = [t for t, latency in listener.frames[seen:] if latency > STALE_MS]
            fresh_ns = next(t for t, latency in listener.frames[seen:] if latency <= STALE_MS)
            fresh_ms = (fresh_ns - awake_ns) * 1e-6
            figures = (Figure(f"first fresh picture after the station stood still for {STALL_S:g} s", fresh_ms, "ms"),)
            remark = (
                f"{link.state.frames_skipped - skipped} frames skipped, {link.state.connections - 1} reconnections;"
                f" {len(stale)} stale frames, the first fresh one {fresh_ms:.0f} ms after the stall"
            )
        else:
            await asyncio.sleep(seconds)
        lasted_s = (time.monotonic_ns() - begin_ns) * 1e-9
        return Row(
            "station stalls 5 s" if does_stall else "steady",
            lasted_s,
            link.state,
            listener.frames,
            (cpu_s(process) - cpu_begin_s) * 60 / lasted_s,
            (memory_begin, megabytes(process)),
            remark,
            figures,
        )


async def run_cut(dataset: Path) -> Row:
    """The driver's link is cut ten times; an observer on a link of its own sees what the motors are told."""
    async with robot_server(dataset) as (process, port):
        wire = Wire(port)
        await wire.mend()
        async with station(wire.port, "driver") as (link, listener), station(port, "observer") as (_, observer):
            joystick = asyncio.create_task(hold_joystick(link))
            await asyncio.sleep(WARM_UP_S)
            listener.begin_ns = begin_ns = time.monotonic_ns()
            cpu_begin_s, memory_begin = cpu_s(process), megabytes(process)
            stop_ms, back_ms, moved = [], [], 0
            for _ in range(CUTS):
                await asyncio.sleep(CONNECTED_S)
                cut_ns = time.monotonic_ns()
                wire.cut()
                await asyncio.sleep(CUT_S)
                mended_ns = time.monotonic_ns()
                await wire.mend()
                while listener.connected_ns[-1] < mended_ns:
                    await asyncio.sleep(0.005)
                back_ms.append((listener.connected_ns[-1] - mended_ns) * 1e-6)
                reports = [(t, v) for t, v in observer.applied if cut_ns < t < mended_ns]
                first_rest_ns = next((t for t, v in reports if v == 0.0), mended_ns)
                stop_ms.append((first_rest_ns - cut_ns) * 1e-6)
                moved += sum(v != 0.0 for t, v in reports if t > first_rest_ns)
            await asyncio.sleep(CONNECTED_S)
            joystick.cancel()
            lasted_s = (time.monotonic_ns() - begin_ns) * 1e-9
            remark = (
                f"{len(stop_ms)} cuts of {CUT_S} s: motors stopped after ≤ {max(stop_ms):.0f} ms and {moved} times"
                f" moved before the link was back; back ≤ {max(back_ms):.0f} ms after the port was there"
            )
            row = Row(
                "link cut 10 times",
                lasted_s,
                link.state,
                listener.frames,
                (cpu_s(process) - cpu_begin_s) * 60 / lasted_s,
                (memory_begin, megabytes(process)),
                remark,
                (
                    Figure("link cut while driving: motors stopped after, longest", max(stop_ms), "ms", of=CUTS),
                    Figure("link cut while driving: motors moved before it was back", moved, at_most=0, of=CUTS),
                    Figure("link back after its network was, longest", max(back_ms), "ms", BACK_WITHIN_MS, of=CUTS),
                ),
            )
        wire.cut()
        return row


async def hold_joystick(link: RobotLink) -> None:
    while True:
        link.commands.drive(0.2, 0.0, 250)
        await asyncio.sleep(0.05)


def main(
    minutes: Annotated[float, typer.Option(help="Length of the steady run.")] = 0.5,
    stall_minutes: Annotated[float, typer.Option(help="Length of the run with the stall.")] = 0.5,
    results: Annotated[Path, typer.Option(help=RESULTS_HELP)] = FOLDER / "link.json",
) -> None:
    """Run all three and print the table."""
    this_run = Run.begin()
    logging.basicConfig(level=logging.ERROR)
    with tempfile.TemporaryDirectory() as folder:
        dataset = Path(folder)
        write_dataset(dataset)
        size = np.mean([p.stat().st_size for p in (dataset / "mav0" / "cam0" / "data").iterdir()])
        print(f"640x480 JPEG of {size / 1e3:.0f} kB at {FRAME_RATE_HZ} fps, IMU {IMU_RATE_HZ} Hz\n")
        print(
            "| run | length | IMU got / lost | frames got / skipped | frame latency p50 / p99 / max ms |"
            " robot-server CPU s/min | memory begin / end MB | |\n| --- | --- | --- | --- | --- | --- | --- | --- |"
        )
        rows = []
        for run in (
            run_plain(dataset, minutes * 60, does_stall=False),
            run_plain(dataset, stall_minutes * 60, does_stall=True),
            run_cut(dataset),
        ):
            rows.append(asyncio.run(run))
            print(rows[-1], flush=True)
    samples, lost = sum(row.state.imu_samples for row in rows), sum(row.state.imu_lost for row in rows)
    latency_ms = float(np.percentile([latency for _, latency in rows[0].frames], 99))
    steady = f"steady link at {FRAME_RATE_HZ} pictures and {IMU_RATE_HZ} IMU samples a second"
    this_run.write(
        results,
        [
            Figure("IMU samples lost: steady, with a stalled station, with a cut link", lost, at_most=0, of=samples),
            Figure(f"{steady}: sensor to station, 99 %", latency_ms, "ms", of=len(rows[0].frames)),
            *(figure for row in rows for figure in row.figures),
        ],
    )
    if lost:
        sys.exit("IMU samples were lost")


if __name__ == "__main__":
    typer.run(main)
