"""Does memory grow with time? Resident memory of robot-server and station, at rest, and while they record and drive.

    python -m benchmarks.bench_memory                                    # a try
    python -m benchmarks.bench_memory --minutes 180 --warm-up 10         # the bound: 1 % in three hours
    python -m benchmarks.bench_memory --devices emulated --doing recording
    python -m benchmarks.bench_memory --minutes 180 --warm-up 10 --fps 5 --together    # three hours instead of a day

Each case has programs of its own: robot-server with simulated, recorded or emulated devices (the real firmware in an
emulated Mega), and a station. `--together` runs all cases at once. Growth is that of the straight line through all
samples after the warm-up. The result file is written every few minutes, of the time there is by then.
"""

from __future__ import annotations

import argparse
import contextlib
import itertools
import tempfile
import threading
import time
from collections.abc import Iterator
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from dataclasses import dataclass, field
from pathlib import Path

import httpx
import numpy as np
import psutil

from benchmarks.bench_fleet import program
from benchmarks.bench_link import write_dataset
from benchmarks.result import Figure, Run, add_results_option
from tests.support.emulator import board

DEVICES = ("simulated", "recorded", "emulated")
WORK = ("resting", "recording")
SAMPLE_S, COMMAND_S, TURN_S = 5.0, 0.1, 6.0
WRITE_S = 300.0
MIN_SAMPLES = 3  # for a straight line
DATASET, ROBOT_SETTINGS = "recorded", "robot.toml"
MAX_GROWTH_PERCENT = 1.0
JUDGED_FROM_MINUTES = 60.0  # in less than that, steps of the allocator hide a slow growth and look like a quick one


@dataclass
class Memory:
    """Resident memory of one program, MB."""

    samples: list[tuple[float, float]] = field(default_factory=list)  # minutes since the end of the warm-up, MB

    def sample(self, t_min: float, process: psutil.Process) -> None:
        self.samples.append((t_min, process.memory_info().rss / 1e6))

    def line(self) -> tuple[float, float]:
        """MB at the begin and at the end of the straight line through all samples."""
        t_min, mb = np.array(self.samples).T
        slope, begin = np.polyfit(t_min, mb, 1)
        return float(begin), float(begin + slope * t_min[-1])


@dataclass(frozen=True, slots=True)
class Case:
    devices: str
    work: str


@dataclass(frozen=True, slots=True)
class Recorded:
    """What was measured of a case so far, by program."""

    case: Case
    memory: dict[str, Memory] = field(default_factory=lambda: {"robot-server": Memory(), "station": Memory()})


def write_settings(folder: Path, fps: float) -> None:
    """The simulator's, and robot-server's that name them."""
    settings = folder / "settings.toml"
    settings.write_text(f"camera_rate_hz = {fps}\n")
    (folder / ROBOT_SETTINGS).write_text(f'[simulated]\nsettings = "{settings}"\n')


def robot_words(devices: str, folder: Path) -> list[str]:
    """`folder`: of the dataset and the simulator's settings."""
    if devices == "recorded":
        return ["--devices", "recorded", "--dataset", str(folder / DATASET), "--at-end", "loop"]
    imu = ["--imu", "emulated"] if devices == "emulated" else []
    words = ["--devices", "simulated", "--world", "small", "--seed", "1", "--sim-port", "0"]
    return [*words, "--config", str(folder / ROBOT_SETTINGS), *imu]


def drive(http: httpx.Client, has_ended: threading.Event) -> None:
    """To and fro, in curves, as somebody at the joystick."""
    for number in itertools.count():
        if has_ended.wait(COMMAND_S):
            return
        way = 1 if int(number * COMMAND_S / TURN_S) % 2 else -1
        with contextlib.suppress(httpx.HTTPError):
            http.post("/drive", json={"linear": 0.15 * way, "angular": 0.4, "ttl_ms": 300})


@contextlib.contextmanager
def at_work(http: httpx.Client, work: str) -> Iterator[None]:
    """Recording and driving, or nothing at all."""
    if work == "resting":
        yield
        return
    answer = http.post("/navigations", json={"name": "memory"})
    answer.raise_for_status()
    has_ended = threading.Event()
    driver = threading.Thread(target=drive, args=(http, has_ended))
    driver.start()
    try:
        yield
    finally:
        has_ended.set()
        driver.join()


def wait_for_robot(http: httpx.Client) -> None:
    while not http.get("/robot").json()["connected"]:
        time.sleep(0.2)


def measure(recorded: Recorded, minutes: float, warm_up: float, folder: Path) -> None:
    case, memory = recorded.case, recorded.memory
    with contextlib.ExitStack() as stack:
        words = robot_words(case.devices, folder)
        robot, told = stack.enter_context(program("robot.main", *words, "--port", "0"))
        data = stack.enter_context(tempfile.TemporaryDirectory(prefix="sentinel-memory-"))
        words = ["serve", "--robot", f"127.0.0.1:{told.rsplit(':', 1)[1]}", "--port", "0", "--data", data]
        station, told = stack.enter_context(program("station.main", *words))
        http = stack.enter_context(httpx.Client(base_url=told.rsplit(" ", 1)[1], timeout=30.0))
        wait_for_robot(http)
        with at_work(http, case.work):
            time.sleep(60.0 * warm_up)
            begin_s = time.monotonic()
            while (t_min := (time.monotonic() - begin_s) / 60.0) < minutes:
                memory["robot-server"].sample(t_min, robot)
                memory["station"].sample(t_min, station)
                time.sleep(SAMPLE_S)


def figures_of(recorded: Recorded, fps: float, is_told: bool) -> Iterator[Figure]:
    case = recorded.case
    for name, one in recorded.memory.items():
        if len(one.samples) < MIN_SAMPLES:
            continue
        begin, end = one.line()
        minutes, last_mb = one.samples[-1]
        percent = 100.0 * (end / begin - 1.0)
        if is_told:
            row = (case.devices, case.work, name, f"{begin:.1f}", f"{end:.1f}", f"{60.0 * (end - begin) / minutes:.1f}")
            print(f"| {' | '.join(row)} | {percent:.2f} |")
        what = f"{name}, {case.devices} devices, {fps:g} pictures/s, {case.work}"
        at_most = MAX_GROWTH_PERCENT if minutes >= JUDGED_FROM_MINUTES else None
        yield Figure(
            f"{what}: growth of memory in {minutes:.0f} min", percent, "%", at_most=at_most, of=len(one.samples)
        )
        yield Figure(f"{what}: memory at the end", last_mb, "MB")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--minutes", type=float, default=2.0, help="Of each case, after its warm-up.")
    parser.add_argument("--warm-up", type=float, default=1.0, help="Minutes before anything counts.")
    parser.add_argument("--fps", type=float, default=20.0, help="pictures a second")
    parser.add_argument("--together", action="store_true", help="all cases at once")
    parser.add_argument("--devices", nargs="+", choices=DEVICES, default=DEVICES)
    parser.add_argument("--doing", nargs="+", choices=WORK, default=WORK)
    add_results_option(parser, "memory")
    options = parser.parse_args()
    if "emulated" in options.devices:
        if (reason := board.missing_reason()) is not None:
            parser.error(reason)
        board.build()
    run = Run.begin()
    cases = [Recorded(Case(devices, work)) for devices, work in itertools.product(options.devices, options.doing)]
    with tempfile.TemporaryDirectory() as name, ThreadPoolExecutor(len(cases) if options.together else 1) as pool:
        folder = Path(name)
        write_dataset(folder / DATASET, options.fps)
        write_settings(folder, options.fps)
        running = {pool.submit(measure, case, options.minutes, options.warm_up, folder) for case in cases}
        failures: list[BaseException] = []
        while running:
            ended, running = wait(running, timeout=WRITE_S, return_when=FIRST_COMPLETED)
            run.write(
                options.results, [figure for case in cases for figure in figures_of(case, options.fps, is_told=False)]
            )
            failures += [failure for one in ended if (failure := one.exception()) is not None]
    print("| devices | work | program | begin MB | end MB | MB per hour | % |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    run.write(options.results, [figure for case in cases for figure in figures_of(case, options.fps, is_told=True)])
    if failures:
        raise failures[0]


if __name__ == "__main__":
    main()
