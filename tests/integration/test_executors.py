"""Heavy work on processes of this machine and on a Dask cluster: the same map, also when a worker is killed."""

from __future__ import annotations

import contextlib
import json
import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import psutil
import pytest

from shared.errors import ConfigError, DataError
from station.maps.record import map_content_hash
from station.workers.executors.opening import open_executor
from station.workers.executors.port import Executor, ExecutorFailed
from station.workers.executors.processes import ProcessExecutor
from station.workers.mapping import MapOfNavigations, Reconstruction, Recorded, make_map, packed, reconstruct_all
from tests.support.paths import RECORDINGS, ROOT
from tests.support.recordings import record_made_up_room

KEYFRAMES = RECORDINGS / "euroc_v1_01_keyframes"
MADE_UP = "tests.support.made_up_workers:StraightSlam"
needs_data = pytest.mark.skipif(not KEYFRAMES.is_dir(), reason="../shared/data/euroc_v1_01_keyframes is absent")


@pytest.fixture(scope="module")
def cluster() -> Iterator[object]:
    """A Dask cluster of two worker processes on this machine."""
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        processes=True,
        host="127.0.0.1",
        dashboard_address="127.0.0.1:0",
        silence_logs=50,
    ) as made:
        yield made


def address(cluster: object) -> str:
    scheduler: str = cluster.scheduler_address
    return scheduler.replace("tcp://", "dask://")


def map_hash(executor: Executor, pieces: list[Reconstruction]) -> str:
    """SLAM over each piece, side by side, then the map of the first."""
    navigations = reconstruct_all(executor, pieces)
    return map_content_hash(executor.map(make_map, [MapOfNavigations((navigations[0],))])[0])


def drive_in_two() -> list[Reconstruction]:
    return [
        Reconstruction(Recorded(KEYFRAMES), first=0, last=13),
        Reconstruction(Recorded(KEYFRAMES), first=14, last=27),
    ]


class Killer(threading.Thread):
    """Kills the first of these processes that has computed for half a second."""

    def __init__(self, workers: Callable[[], list[int]], base: dict[int, float]) -> None:
        super().__init__()
        self._workers, self._base = workers, base
        self.killed: int | None = None
        self.start()

    def run(self) -> None:
        deadline = time.monotonic() + 200
        while time.monotonic() < deadline:
            for pid in self._workers():
                try:
                    spent = sum(psutil.Process(pid).cpu_times()[:2])
                except psutil.NoSuchProcess:
                    continue
                if spent - self._base.get(pid, 0.0) > 0.5:
                    os.kill(pid, signal.SIGKILL)
                    self.killed = pid
                    return
            time.sleep(0.02)


def children() -> list[int]:
    return [child.pid for child in multiprocessing.active_children() if child.pid]


def nannies(cluster: object) -> list[int]:
    return [nanny.pid for nanny in cluster.workers.values() if nanny.pid]


@needs_data
def test_a_cluster_makes_the_same_map_and_a_killed_worker_changes_nothing(cluster: object) -> None:
    with ProcessExecutor(2) as processes:
        expected = map_hash(processes, drive_in_two())
    with ProcessExecutor(2) as processes:
        before = children()
        killer = Killer(lambda: [pid for pid in children() if pid not in before], {})
        assert map_hash(processes, drive_in_two()) == expected
        killer.join()
        assert killer.killed and killer.killed not in children()
    with open_executor(address(cluster)) as machines:
        base = {pid: sum(psutil.Process(pid).cpu_times()[:2]) for pid in nannies(cluster)}
        killer = Killer(lambda: [pid for pid in nannies(cluster) if pid in base], base)
        assert map_hash(machines, drive_in_two()) == expected
        killer.join()
        assert killer.killed and killer.killed not in nannies(cluster)


def test_a_recording_travels_to_a_cluster_and_gives_the_same_map(cluster: object, tmp_path: Path) -> None:
    pieces = [
        Reconstruction(Recorded(record_made_up_room(tmp_path / f"{n}.mcap", brightness=n)), MADE_UP) for n in range(3)
    ]
    with ProcessExecutor(2) as processes, open_executor(address(cluster)) as machines:
        assert not machines.shares_disk
        assert map_hash(processes, pieces) == map_hash(machines, pieces)


def fail(piece: int) -> int:
    raise DataError(f"piece {piece} is broken")


def die(piece: int) -> int:
    os._exit(9)


def double(piece: int) -> int:
    return 2 * piece


def test_results_come_in_order_and_errors_as_they_were_raised(cluster: object) -> None:
    for executor in (ProcessExecutor(2), open_executor(address(cluster))):
        with executor:
            counted: list[int] = []
            assert executor.map(double, [3, 1, 2], counted.append) == [6, 2, 4]
            assert counted == [1, 2, 3]
            with pytest.raises(DataError, match="piece 5 is broken"):
                executor.map(fail, [5])


def nap(begun: Path) -> None:
    begun.touch()
    time.sleep(600)


@contextlib.contextmanager
def own_cluster(folder: Path) -> Iterator[tuple[str, list[subprocess.Popen[bytes]]]]:
    """Scheduler and one worker as a person starts them: the executor's address, and both programs."""
    pytest.importorskip("distributed")
    file = folder / "scheduler.json"
    words = (("scheduler", "--host", "127.0.0.1", "--port", "0"), ("worker", "--nthreads", "1", "--no-nanny"))
    programs: list[subprocess.Popen[bytes]] = []
    env = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, (Path(__file__).parent, ROOT)))}
    with (folder / "log").open("wb") as log:
        try:
            for kind, *options in words:
                command = [sys.executable, "-m", f"distributed.cli.dask_{kind}", *options, "--no-dashboard"]
                command += ["--scheduler-file", str(file)]
                programs.append(subprocess.Popen(command, stdout=log, stderr=log, env=env))
            wait_until(lambda: file.is_file() and file.stat().st_size > 0)  # the scheduler makes it, then writes it
            address = json.loads(file.read_text())["address"].replace("tcp://", "dask://")
            yield address, programs
        finally:
            for program in programs:
                program.kill()
                program.wait()


def wait_until(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 120
    while not condition():
        assert time.monotonic() < deadline, "the awaited condition did not come true"
        time.sleep(0.05)


def opened(where: str) -> Executor:
    """As soon as its worker is there."""
    deadline = time.monotonic() + 120
    while True:
        try:
            return open_executor(where)
        except ConfigError as exc:
            if "no workers" not in str(exc) or time.monotonic() > deadline:
                raise
            time.sleep(0.2)


@pytest.mark.parametrize(("dying", "sentence"), [(0, "scheduler went away at work"), (1, "had no workers for 1 s")])
def test_a_cluster_that_dies_at_work_is_told_and_nobody_waits_for_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, dying: int, sentence: str
) -> None:
    """The second piece has not begun by then: it waits in the scheduler."""
    with own_cluster(tmp_path) as (where, programs):
        machines = opened(where)
        monkeypatch.setattr("station.workers.executors.dask.ASK_S", 0.5)
        monkeypatch.setattr("station.workers.executors.dask.DESERTED_FOR_S", 1.0)
        failures: list[BaseException] = []

        def work() -> None:
            try:
                machines.map(nap, [tmp_path / "first", tmp_path / "second"])
            except BaseException as exc:
                failures.append(exc)

        with machines:
            working = threading.Thread(target=work)
            working.start()
            wait_until((tmp_path / "first").is_file)
            programs[dying].kill()
            working.join(120)
        assert [type(failure) for failure in failures] == [ExecutorFailed]
        assert sentence in str(failures[0])


def test_a_piece_that_kills_its_workers_is_given_up() -> None:
    with ProcessExecutor(1) as processes, pytest.raises(ExecutorFailed, match="1 of 1 pieces of die"):
        processes.map(die, [0])


def test_processes_of_a_pool_end_with_it() -> None:
    before = set(children())
    with ProcessExecutor(2) as processes:
        processes.map(double, [1, 2])
        made = set(children()) - before
        assert made
    assert not made & set(children())


@pytest.mark.parametrize("wrong", ["dask", "dask://host", "dask://:8786", "tcp://host:1", "ray://host:1"])
def test_wrong_addresses_of_executors_are_refused(wrong: str) -> None:
    with pytest.raises(ConfigError, match="dask://HOST:PORT"):
        open_executor(wrong)


def test_a_folder_travels_with_all_its_files(tmp_path: Path) -> None:
    (tmp_path / "drive" / "mav0").mkdir(parents=True)
    (tmp_path / "drive" / "mav0" / "x.csv").write_text("1")
    assert packed(tmp_path / "drive").files == (("mav0/x.csv", b"1"),)
    with pytest.raises(DataError, match="cannot be read"):
        packed(tmp_path / "nowhere.mcap")
