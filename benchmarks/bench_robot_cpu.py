"""CPU time of robot-server, idle and streaming: serial line with a Mega's frames at 225 Hz, pictures of 50 kB at 30 Hz.

    python -m benchmarks.bench_robot_cpu [--seconds 20] [--results FILE]

The line is a pseudo terminal at which this program plays the Mega (the emulated one may starve on a busy PC, and then
sends less). CPU time of the process is taken, not wall time, and divided by the frames there were, so a busy PC matters
little; where `frames_per_s` is far below 30 it still makes the figures worthless.
The frames come compressed: what the Pi's camera
stack and its JPEG encoder take is not in it; one `cv2.imencode` of such a picture stands beside it as a hint.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import os
import pty
import sys
import tempfile
import threading
import time
import tty

import cv2
import numpy as np
import psutil

from benchmarks.result import Figure, Run, add_results_option
from shared import serial_protocol as sp
from shared.messages import CameraFrame, Depth, DriveApplied, ErrorNotice, Hello, ImuBatch, Status
from station.robots.link import RobotLink
from tests.support.paths import ROOT
from tests.support.robot_cpu import starved

RATE_HZ, FRAME_BYTES, IMU_RATE_HZ = 30, 50_000, 225


class PlayedMega:
    """Says hello when asked, confirms its settings, sends samples and status as a Mega does. Ignores all else."""

    def __init__(self) -> None:
        self._master, slave = pty.openpty()
        tty.setraw(slave)
        self._slave = slave
        self.port = os.ttyname(slave)
        self._is_closed = False
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        os.set_blocking(self._master, False)
        hello = sp.encode_frame(sp.pack(sp.Hello(sp.PROTOCOL_VERSION, 1, 0, 1, 0x69, 0xEA, 1, 1, 3, 3, 4, 1)))
        status = sp.encode_frame(sp.pack(sp.Status(100, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 7400, 0, 0, 100, 6000)))
        start_s, sent = time.monotonic(), 0
        while not self._is_closed:
            out = b""
            with contextlib.suppress(BlockingIOError):
                heard = os.read(self._master, 4096)
                out += hello if sp.encode(sp.AskHello()) in heard else b""
                for kind in (sp.Type.CONFIG_IMU, sp.Type.CONFIG_MOTORS):
                    asks = any(frame[1:2] == bytes([kind]) for frame in heard.split(b"\0"))
                    out += sp.encode_frame(sp.pack(sp.Ack(kind, 0))) if asks else b""
            due = int((time.monotonic() - start_s) * IMU_RATE_HZ)
            for number in range(max(sent, due - 50), due):
                t_us = round(number * 1e6 / IMU_RATE_HZ)
                out += sp.encode_frame(sp.pack(sp.ImuPacket(number, t_us, 0x11, bytes(range(23)))))
                out += status if number % 22 == 0 else b""
            sent = due
            with contextlib.suppress(BlockingIOError):  # nobody reads yet
                os.write(self._master, out)
            time.sleep(0.004)

    def close(self) -> None:
        self._is_closed = True
        self._thread.join()
        os.close(self._master)
        os.close(self._slave)


class Counter:
    """A station that only counts."""

    def __init__(self) -> None:
        self.frames = self.samples = 0

    def on_connected(self, _hello: Hello) -> None: ...

    def on_calibration(self, _hello: Hello) -> None: ...

    def on_disconnected(self, _reason: str) -> None: ...

    def on_frame(self, _frame: CameraFrame, _t_station_ns: int) -> None:
        self.frames += 1

    def on_imu(self, batch: ImuBatch) -> None:
        self.samples += len(batch.samples)

    def on_gap(self, _num_samples: int) -> None: ...

    def on_depth(self, _depth: Depth) -> None: ...

    def on_drive_applied(self, _applied: DriveApplied) -> None: ...

    def on_status(self, _status: Status) -> None: ...

    def on_notice(self, _notice: ErrorNotice) -> None: ...


class Server:
    """robot-server with a camera that has its pictures ready."""

    def __init__(self, process: asyncio.subprocess.Process) -> None:
        self._process = process
        self._meter = psutil.Process(process.pid)

    async def cpu(self, seconds: float) -> dict[str, float]:
        """CPU time as a share of a core and for each frame of the camera, and what the camera made."""
        frames, cpu_s, start_s = await self._frames(), self._cpu_s(), time.monotonic()
        await asyncio.sleep(seconds)
        used_s, wall_s = self._cpu_s() - cpu_s, time.monotonic() - start_s
        made = await self._frames() - frames
        return {
            "percent_of_a_core": round(100 * used_s / wall_s, 1),
            "ms_per_frame": round(1000 * used_s / max(1, made), 2),
            "frames_per_s": round(made / wall_s, 1),
        }

    def _cpu_s(self) -> float:
        return float(sum(self._meter.cpu_times()[:2]))

    async def _frames(self) -> int:
        assert self._process.stdin is not None and self._process.stdout is not None
        self._process.stdin.write(b"count\n")
        return int((await self._process.stdout.readline()).split()[1])


async def measure(seconds: float) -> dict[str, object]:
    """Idle, streaming to one station and to three, and streaming while driven."""
    results: dict[str, object] = {}
    with tempfile.TemporaryDirectory() as folder:
        mega = PlayedMega()
        command = [sys.executable, "-m", "tests.support.stopping.robot", "--serial", mega.port]
        command += ["--log", f"{folder}/log", "--rate-hz", str(RATE_HZ), "--ready-frames", str(FRAME_BYTES)]
        server = await asyncio.create_subprocess_exec(*command, cwd=ROOT, stdin=-1, stdout=-1)
        try:
            assert server.stdout is not None
            port = int((await server.stdout.readline()).split()[1])
            robot = Server(server)
            await asyncio.sleep(2)
            results["idle: no station"] = await robot.cpu(seconds)
            counters = [Counter() for _ in range(3)]
            links = [RobotLink("127.0.0.1", port, counter) for counter in counters]
            tasks = [asyncio.create_task(links[0].run())]
            await asyncio.sleep(2)
            begun_s = time.monotonic()
            samples = links[0].state.imu_samples
            results["streaming to one station"] = await robot.cpu(seconds)
            driving = asyncio.create_task(drive(links[0]))
            results["streaming to one station, driven"] = await robot.cpu(seconds)
            driving.cancel()
            tasks += [asyncio.create_task(link.run()) for link in links[1:]]
            await asyncio.sleep(2)
            results["streaming to three stations"] = await robot.cpu(seconds)
            state = links[0].state
            results["first station"] = {
                "frames_skipped": state.frames_skipped,
                "imu_per_s": round((state.imu_samples - samples) / (time.monotonic() - begun_s), 1),
                "imu_lost": state.imu_lost,
            }
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, driving, return_exceptions=True)
        finally:
            server.terminate()
            await server.wait()
            mega.close()
    results["one JPEG of 640x480 by OpenCV, CPU ms"] = jpeg_cpu_ms()
    return results


async def drive(link: RobotLink) -> None:
    while True:
        link.commands.drive(0.2, 0.0, 250)
        await asyncio.sleep(0.05)


def jpeg_cpu_ms() -> float:
    """Mean CPU time of compressing a textured picture at quality 80."""
    rng = np.random.default_rng(0)
    picture = cv2.resize(rng.integers(0, 255, (120, 160, 3), np.uint8), (640, 480), interpolation=cv2.INTER_CUBIC)
    start_s = time.process_time()
    for _ in range(50):
        cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 80])
    return round(1000 * (time.process_time() - start_s) / 50, 2)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=20.0, help="of each of the four measurements")
    add_results_option(parser, "robot_cpu")
    options = parser.parse_args()
    run = Run.begin()
    result = asyncio.run(measure(options.seconds))
    for name, value in result.items():
        print(f"{name}: {value}")
    if slow := starved(result):
        print(f"bench_robot_cpu: worthless, too few frames came: {', '.join(slow)}", file=sys.stderr)
        return 1
    run.write(options.results, figures(result))
    return 0


def figures(result: dict[str, object]) -> list[Figure]:
    """CPU of robot-server in each state, and whether the inertial samples were whole."""
    found = []
    for name, value in result.items():
        if isinstance(value, dict) and "percent_of_a_core" in value:
            found.append(Figure(f"robot-server, {name}: CPU", value["percent_of_a_core"], "% of a core"))
        elif isinstance(value, dict):
            found.append(Figure("IMU samples lost at the first station", value["imu_lost"], at_most=0))
    return found


if __name__ == "__main__":
    sys.exit(main())
