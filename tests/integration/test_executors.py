"""Heavy work on processes of this machine and on a Dask cluster: the same map, also when a worker is killed."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import psutil
import pytest

from shared.errors import ConfigError, DataError
from station.executors.opening import open_executor
from station.executors.port import Executor, ExecutorFailed
from station.executors.processes import ProcessExecutor
from station.heavy import MapOfNavigations, Reconstruction, Recorded, make_map, packed, reconstruct_all
from station.maps.record import map_content_hash
from tests.integration.test_replay import record

KEYFRAMES = Path(__file__).parents[2].parent / "shared" / "data" / "euroc_v1_01_keyframes"
MADE_UP = "tests.made_up_workers:StraightSlam"
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
        assert killer.killed is not None
    with open_executor(address(cluster)) as machines:
        base = {pid: sum(psutil.Process(pid).cpu_times()[:2]) for pid in nannies(cluster)}
        killer = Killer(lambda: [pid for pid in nannies(cluster) if pid in base], base)
        assert map_hash(machines, drive_in_two()) == expected
        killer.join()
        assert killer.killed is not None


def test_a_recording_travels_to_a_cluster_and_gives_the_same_map(cluster: object, tmp_path: Path) -> None:
    pieces = [Reconstruction(Recorded(record(tmp_path / f"{n}.mcap", brightness=n)), MADE_UP) for n in range(3)]
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
