"""Ten robots on one station: nothing inertial lost, quick answers, flat memory, and a SLAM worker killed every 20 s.

    python -m benchmarks.bench_fleet [--robots 10] [--minutes 10] [--backend sfm] [--drive FOLDER] [--json FILE]
        [--results FILE]

Everything runs on this machine: robot-server programs that play one simulated drive in a loop (5 fps, 225 Hz IMU), the
station with a map active and a drive being recorded for each robot, and the asker. Needs Linux (worker names in /proc).
"""

from __future__ import annotations

import argparse
import contextlib
import itertools
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import psutil

from benchmarks.result import Figure, Run, add_results_option
from station.maps.store import MapStore
from station.workers.executors.processes import ProcessExecutor
from station.workers.mapping import MapOfNavigations, Reconstruction, Recorded, make_map, reconstruct_all
from tests.support.paths import ROOT

FPS, DRIVE_S = 5, 60
WARM_UP_S = 30.0  # workers start, queues of SLAM fill
ALL_LOCATE_WITHIN_S = 240.0  # one robot's worker makes the index of the map first; answers are dear from then on
KILL_EVERY_S, MEMORY_EVERY_S, ASK_EVERY_S = 20.0, 10.0, 0.05
LOST = "SLAM was lost"
ANSWER_WITHIN_MS, BACK_WITHIN_S = 50.0, 3.0  # asked


@dataclass
class Result:
    """What was seen; times in s unless named."""

    robots: int
    seconds: float
    latency_ms: dict[str, float] = field(default_factory=dict)
    back_after_s: list[float] = field(default_factory=list)
    imu: int = 0
    imu_lost: int = 0
    imu_lost_to_workers: list[str] = field(default_factory=list)  # what logs say of it
    frames: int = 0
    frames_skipped_by_link: int = 0
    frames_skipped_by_slam: int = 0
    place_answers: int = 0
    errors_of_others: list[str] = field(default_factory=list)  # in logs of robots whose worker was not killed
    station_mb: list[float] = field(default_factory=list)
    workers_mb: list[float] = field(default_factory=list)  # all of them, what each has for itself
    cpu_s: dict[str, float] = field(default_factory=dict)
    localising: list[int] = field(default_factory=list)  # robots whose localisation has its index, at each look


@contextlib.contextmanager
def program(*words: str) -> Iterator[tuple[psutil.Process, str]]:
    """A program of ours and its first line."""
    started = subprocess.Popen([sys.executable, "-m", *words], cwd=ROOT, stdout=subprocess.PIPE, text=True)
    assert started.stdout is not None
    try:
        yield psutil.Process(started.pid), started.stdout.readline().strip()
    finally:
        started.terminate()
        started.wait(60)


def prepare(folder: Path, drive: Path) -> None:
    """A simulated drive, unless it is there already, and its map in the station's store."""
    words = ["--out", str(drive), "--world", "small", "--seed", "1", "--fps", str(FPS), "--max-duration", str(DRIVE_S)]
    if not drive.is_dir():
        subprocess.run([sys.executable, "-m", "robot.simulation.cli", "dataset", *words], cwd=ROOT, check=True)
    with ProcessExecutor(1) as here:
        navigations = reconstruct_all(here, [Reconstruction(Recorded(drive))])
        place_map = here.map(make_map, [MapOfNavigations(tuple(navigations), name="fleet")])[0]
    MapStore(folder / "data" / "maps").save(place_map)
    (folder / "data" / "maps" / "active.json").write_text(json.dumps({"id": place_map.id}))


def cpu_s(process: psutil.Process) -> float:
    times = process.cpu_times()
    return float(times.user + times.system)


class Fleet:
    """The running station, asked over HTTP and watched from outside."""

    def __init__(self, http: httpx.Client, station: psutil.Process, robots: int) -> None:
        self.http = http
        self.station = station
        self.names = [f"robot-{n}" for n in range(1, robots + 1)]

    def get(self, path: str) -> Any:
        answer = self.http.get(path)
        answer.raise_for_status()
        return answer.json()

    def slam_worker(self, robot: str) -> psutil.Process | None:
        for process in self.station.children(recursive=True):
            with contextlib.suppress(psutil.NoSuchProcess, FileNotFoundError):  # it may end while we look
                if Path(f"/proc/{process.pid}/comm").read_text().strip() == f"SLAM {robot}"[:15]:
                    return process
        return None

    def workers_mb(self) -> float:
        total = 0.0
        for process in self.station.children(recursive=True):
            with contextlib.suppress(psutil.NoSuchProcess):
                total += process.memory_full_info().uss / 1e6
        return total

    def num_localising(self) -> int:
        """Robots whose pictures are looked for in the map: their answers are no longer missing, whatever they say."""
        num = 0
        for line in self.http.get("/metrics").text.splitlines():
            num += line.startswith("sentinel_place_answers_total") and float(line.rsplit(" ", 1)[1]) > 0
        return num

    def workers_cpu_s(self) -> float:
        total = 0.0
        for process in self.station.children(recursive=True):
            with contextlib.suppress(psutil.NoSuchProcess):
                total += cpu_s(process)
        return total


@dataclass
class Kill:
    """A SLAM worker that was killed and is awaited."""

    robot: str
    pid: int
    at_s: float


def is_back(fleet: Fleet, kill: Kill) -> bool:
    worker = fleet.slam_worker(kill.robot)
    if worker is None or worker.pid == kill.pid:
        return False
    return not fleet.get(f"/robots/{kill.robot}/pose")["message"].startswith(LOST)


def watch(
    fleet: Fleet, seconds: float, result: Result, robots: list[psutil.Process], keep: Callable[[Result], None]
) -> None:
    """Ask, kill and look, for so long; `keep` is given what was seen until then, now and then."""
    latencies: list[float] = []
    asked = itertools.cycle(fleet.names)
    victims = itertools.cycle(fleet.names)
    kill: Kill | None = None
    hurt: set[str] = set()
    begin_s = time.monotonic()
    next_kill_s, next_memory_s = begin_s + KILL_EVERY_S / 2, begin_s
    cpu_begin = (cpu_s(fleet.station), fleet.workers_cpu_s(), sum(map(cpu_s, robots)))
    while (now_s := time.monotonic()) < begin_s + seconds or kill is not None:
        fleet.get(f"/robots/{next(asked)}/place/current")
        latencies.append((time.monotonic() - now_s) * 1e3)
        if kill is not None and is_back(fleet, kill):
            result.back_after_s.append(round(time.monotonic() - kill.at_s, 2))
            kill = None
        elif kill is None and now_s >= next_kill_s and now_s < begin_s + seconds:
            next_kill_s = now_s + KILL_EVERY_S
            robot = next(victims)
            worker = fleet.slam_worker(robot)
            if worker is not None:
                hurt.add(robot)
                kill = Kill(robot, worker.pid, time.monotonic())
                worker.kill()
        if now_s >= next_memory_s:
            next_memory_s = now_s + MEMORY_EVERY_S
            result.station_mb.append(round(fleet.station.memory_info().rss / 1e6, 1))
            result.workers_mb.append(round(fleet.workers_mb(), 1))
            result.localising.append(fleet.num_localising())
            result.latency_ms = percentiles(latencies)
            result.seconds = round(now_s - begin_s, 1)
            keep(result)
        time.sleep(max(0.0, ASK_EVERY_S - (time.monotonic() - now_s)))
    result.seconds = round(time.monotonic() - begin_s, 1)
    ends = (cpu_s(fleet.station), fleet.workers_cpu_s(), sum(map(cpu_s, robots)))
    names = ("station", "workers alive at the end", "robot-servers")
    result.cpu_s = {name: round(end - begin, 1) for name, begin, end in zip(names, cpu_begin, ends, strict=True)}
    result.latency_ms = percentiles(latencies)
    count(fleet, result, hurt)


def percentiles(latencies: list[float]) -> dict[str, float]:
    return {f"p{p}": round(float(np.percentile(latencies, p)), 1) for p in (50, 95, 99, 100)}


def count(fleet: Fleet, result: Result, hurt: set[str]) -> None:
    for entry in fleet.get("/robots"):
        losses = entry["robot"]["losses"]
        result.imu_lost += losses["imu_lost"] + losses["imu_lost_in_sensor"]
        result.frames_skipped_by_link += losses["frames_skipped"]
        log = fleet.get(f"{entry['path']}/log")
        result.imu_lost_to_workers += [line["text"] for line in log if "inertial samples" in line["text"]]
        if entry["name"] not in hurt:
            result.errors_of_others += [line["text"] for line in log if line["level"] == "error"]
    for drive in fleet.get("/navigations"):
        result.imu += drive["imu_samples"]
        result.imu_lost += drive["imu_lost"]
        result.frames += drive["frames"]
        result.frames_skipped_by_slam += drive["frames_skipped"]
    for line in fleet.http.get("/metrics").text.splitlines():
        if line.startswith("sentinel_place_answers_total"):
            result.place_answers += int(float(line.rsplit(" ", 1)[1]))


def bench(robots: int, seconds: float, backend: str, drive: Path | None, keep: Callable[[Result], None]) -> Result:
    result = Result(robots, seconds)
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="fleet-")))
        dataset = drive or folder / "drive"
        prepare(folder, dataset)
        play = ["--devices", "recorded", "--dataset", str(dataset), "--at-end", "loop", "--port", "0"]
        started = [stack.enter_context(program("robot.main", *play)) for _ in range(robots)]
        ports = [line.rsplit(":", 1)[1] for _, line in started]
        words = [word for port in ports for word in ("--robot", f"127.0.0.1:{port}")]
        options = ["--data", str(folder / "data"), "--port", "0", "--backend", backend]
        station, line = stack.enter_context(program("station.main", "serve", *words, *options))
        http = stack.enter_context(httpx.Client(base_url=line.rsplit(" ", 1)[1], timeout=30))
        fleet = Fleet(http, station, robots)
        deadline_s = time.monotonic() + 60
        while not all(entry["robot"]["connected"] for entry in fleet.get("/robots")):
            assert time.monotonic() < deadline_s, "not all robots are connected after a minute"
            time.sleep(0.2)
        for name in fleet.names:
            http.post(f"/robots/{name}/navigations", json={"name": name}).raise_for_status()
        time.sleep(WARM_UP_S)
        deadline_s = time.monotonic() + ALL_LOCATE_WITHIN_S
        while fleet.num_localising() < robots and time.monotonic() < deadline_s:
            time.sleep(1.0)
        watch(fleet, seconds, result, [process for process, _ in started], keep)
    return result


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robots", type=int, default=10)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--backend", default="sfm")
    parser.add_argument("--drive", type=Path, help="folder of the simulated drive; made when it is not there")
    parser.add_argument("--json", type=Path, help="the result so far, all the time")
    add_results_option(parser, "fleet")
    options = parser.parse_args()
    run = Run.begin()

    def keep(result: Result) -> None:
        if options.json:
            options.json.write_text(json.dumps(asdict(result), indent=1) + "\n")

    result = bench(options.robots, options.minutes * 60, options.backend, options.drive, keep)
    keep(result)
    print(json.dumps(asdict(result), indent=1))
    run.write(options.results, figures(result))


def figures(result: Result) -> list[Figure]:
    """What is asked of a station with many robots."""
    fleet = f"{result.robots} robots"
    minutes = max(result.seconds / 60, 1e-9)
    grown_mb = (result.station_mb[-1] - result.station_mb[0]) / minutes if result.station_mb else None
    lost = result.imu_lost + len(result.imu_lost_to_workers)
    return [
        Figure(f"{fleet}: IMU samples lost, by the link and by SLAM", lost, at_most=0, of=result.imu),
        Figure(f"{fleet}: current place asked over HTTP, 95 %", result.latency_ms.get("p95"), "ms", ANSWER_WITHIN_MS),
        Figure(
            f"{fleet}: SLAM back after its worker was killed, longest",
            max(result.back_after_s, default=None), "s", BACK_WITHIN_S, of=len(result.back_after_s),
        ),
        Figure(f"{fleet}: errors in logs of robots that were not hurt", len(result.errors_of_others), at_most=0),
        Figure(f"{fleet}: growth of the station's memory", grown_mb, "MB a minute"),
    ]  # fmt: skip


if __name__ == "__main__":
    main()
