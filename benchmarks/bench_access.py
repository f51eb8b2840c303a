"""What access control costs: CPU per megabyte of video with and without TLS, and the time of a pairing.

python -m benchmarks.bench_access [--frames 600] [--results FILE]
"""

from __future__ import annotations

import argparse
import asyncio
import tempfile
import time
from pathlib import Path

from benchmarks.result import Figure, Run, add_results_option
from shared.access import Role
from shared.pairing import Pake
from station.access.paired_robots import PairedRobots
from station.robots.link import RobotLink
from tests.support.access import guarded_robot
from tests.support.link import Bench, Notes, running_robot, until

FRAME_BYTES = 60_000


async def cpu_s_per_mb(bench: Bench, robots: PairedRobots | None, frames: int) -> float:
    """Of robot and station together, one after the other frame."""
    notes = Notes()
    link = RobotLink("127.0.0.1", bench.port, notes, robots=robots)
    task = asyncio.create_task(link.run())
    await until(lambda: link.state.connected)
    begun = time.process_time()
    for number in range(frames):
        bench.camera.put(number, FRAME_BYTES)
        while not notes.frames or notes.frames[-1][0].t_robot_ns < number:
            await asyncio.sleep(0)
    used = time.process_time() - begun
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)
    return used / (frames * FRAME_BYTES * 1e-6)


async def measure(frames: int) -> list[Figure]:
    with tempfile.TemporaryDirectory() as folder:
        async with running_robot() as bench:
            plain = await cpu_s_per_mb(bench, None, frames)
        async with guarded_robot(Path(folder) / "robot") as guarded:
            robots = PairedRobots(Path(folder) / "station")
            guarded.admit("desk", Role.DRIVE, robots)
            tls = await cpu_s_per_mb(guarded, robots, frames)
    print(f"CPU of both ends per MB: plain {plain * 1e3:.2f} ms, TLS {tls * 1e3:.2f} ms")
    begun = time.process_time()
    for _ in range(20):
        robot, station = Pake("robot", "123456", b"f"), Pake("station", "123456", b"f")
        robot.receive(station.message)
        station.receive(robot.message)
    pairing_ms = (time.process_time() - begun) / 40 * 1e3
    print(f"pairing: {pairing_ms:.1f} ms of CPU on each side")
    return [
        Figure("CPU of both ends per MB of video, plain", plain * 1e3, "ms", of=frames),
        Figure("CPU of both ends per MB of video, TLS", tls * 1e3, "ms", of=frames),
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=600)
    add_results_option(parser, "access")
    options = parser.parse_args()
    run = Run.begin()
    run.write(options.results, asyncio.run(measure(options.frames)))


if __name__ == "__main__":
    main()
