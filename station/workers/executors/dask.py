"""Heavy work on a Dask cluster, given by the address of its scheduler (docs/scale.md)."""

from __future__ import annotations

import contextlib
import time
import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import CancelledError
from importlib.metadata import PackageNotFoundError, version
from typing import Any, TypeVar

from distributed import Client, Future
from distributed.comm.core import CommClosedError
from distributed.scheduler import KilledWorker

from shared.errors import ConfigError
from station.workers.executors.port import Closing, ExecutorFailed

P = TypeVar("P")
R = TypeVar("R")
CONNECT_WITHIN_S = 10
LOOK_S = 0.05
ASK_S = 5.0  # how often it is asked whether anybody is there who works
DESERTED_FOR_S = 60.0  # a worker that died is back by then, where something starts it again
SCHEDULER_GONE = "the Dask scheduler went away at work; start it, and try again"
# Whose version may change a result's last bits.
DECIDING = ("sentinel-robot", "numpy", "scipy", "opencv-python-headless", "pycolmap", "scikit-learn", "small-gicp")


class DaskExecutor(Closing):
    """A client of a cluster. The scheduler gives a dead worker's pieces to another one."""

    shares_disk = False

    def __init__(self, address: str) -> None:
        """`address` of the scheduler, such as tcp://10.0.0.5:8786.

        Raises ConfigError: nobody answers there, or a worker has other versions than this machine.
        """
        try:
            self.client = Client(address, timeout=CONNECT_WITHIN_S, set_as_default=False)
        except (OSError, ValueError) as exc:
            raise ConfigError(f"no Dask scheduler answers at {address} ({exc}); start `dask scheduler` there") from exc
        try:
            _refuse_others(self.client.run(versions))
        except BaseException:
            self.client.close()
            raise

    def map(
        self, function: Callable[[P], R], pieces: Sequence[P], done: Callable[[int], None] = lambda _: None
    ) -> list[R]:
        with warnings.catch_warnings():
            # A recording travels inside its piece, so that the scheduler can give it to another worker.
            warnings.filterwarnings("ignore", "Sending large graph", UserWarning)
            # Not pure: Dask would take equal pieces for one.
            futures = [self.client.submit(function, piece, pure=False, retries=0) for piece in pieces]
        try:
            self._wait_for(futures, done)
            return [future.result() for future in futures]
        except KilledWorker as exc:
            raise ExecutorFailed(
                f"a piece of {function.__name__} was not done: {exc.allowed_failures + 1} workers died of it;"
                " is there enough memory?"
            ) from exc
        except (CancelledError, CommClosedError) as exc:
            raise ExecutorFailed(SCHEDULER_GONE) from exc
        finally:
            with contextlib.suppress(CancelledError, OSError, TimeoutError):
                self.client.cancel(futures)

    def _wait_for(self, futures: Sequence[Future[Any]], done: Callable[[int], None]) -> None:
        """Until all are over. Raises ExecutorFailed: nobody has been there for a while who could do the rest."""
        count = 0
        asked_s = served_s = time.monotonic()
        while count < len(futures):
            time.sleep(LOOK_S)
            for _ in range(sum(future.done() for future in futures) - count):
                count += 1
                done(count)
            now_s = time.monotonic()
            if now_s - asked_s < ASK_S:
                continue
            asked_s = now_s
            try:
                threads = self.client.nthreads()
            except OSError as exc:  # it gave up connecting again; a piece's own OSError comes with its result
                raise ExecutorFailed(SCHEDULER_GONE) from exc
            if threads:
                served_s = now_s
            elif now_s - served_s > DESERTED_FOR_S:
                raise ExecutorFailed(
                    f"the Dask cluster had no workers for {DESERTED_FOR_S:.0f} s; start `dask worker`, and try again"
                )

    def close(self) -> None:
        with contextlib.suppress(OSError, TimeoutError):  # a scheduler that is gone cannot be told
            self.client.close()


def versions() -> dict[str, str]:
    """What is installed here of that which decides results."""
    found = {}
    for name in DECIDING:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "missing"
    return found


def _refuse_others(by_worker: dict[str, dict[str, str]]) -> None:
    ours = versions()
    if not by_worker:
        raise ConfigError("the Dask cluster has no workers; start `dask worker ADDRESS` with Sentinel installed")
    for worker, theirs in by_worker.items():
        for name in DECIDING:
            if theirs[name] != ours[name]:
                raise ConfigError(
                    f"the Dask worker {worker} has {name} {theirs[name]}, this machine {ours[name]}; install the same,"
                    " or results would differ"
                )
