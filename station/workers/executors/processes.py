"""Heavy work in processes of this machine."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from typing import TypeVar

from station.workers.executors.port import MAX_TRIES, Closing, ExecutorFailed

P = TypeVar("P")
R = TypeVar("R")
NICE = 15  # below the workers of robots


class ProcessExecutor(Closing):
    """A pool that is made anew when one of its processes dies; what was not done by then is done again."""

    shares_disk = True

    def __init__(self, num_processes: int = 0) -> None:
        """`num_processes` 0: as many as there are cores."""
        self._num_processes = num_processes or os.cpu_count() or 1
        self._pool: ProcessPoolExecutor | None = None

    def map(
        self, function: Callable[[P], R], pieces: Sequence[P], done: Callable[[int], None] = lambda _: None
    ) -> list[R]:
        results: dict[int, R] = {}
        for _ in range(MAX_TRIES):
            try:
                self._run(function, pieces, results, done)
            except BrokenProcessPool:
                self.close()
                continue
            return [results[number] for number in range(len(pieces))]
        raise ExecutorFailed(
            f"{len(pieces) - len(results)} of {len(pieces)} pieces of {function.__name__} were not done:"
            f" their processes died {MAX_TRIES} times; is there enough memory?"
        )

    def _run(
        self, function: Callable[[P], R], pieces: Sequence[P], results: dict[int, R], done: Callable[[int], None]
    ) -> None:
        if self._pool is None:
            # A job's own process may have no children as long as it counts as one that ends with the station's
            # interpreter. It ends with the station all the same, when its pipe does, and the pool with it (_begin).
            multiprocessing.current_process().daemon = False
            context = multiprocessing.get_context("forkserver")
            self._pool = ProcessPoolExecutor(self._num_processes, context, initializer=_begin)
        left = {self._pool.submit(function, pieces[n]): n for n in range(len(pieces)) if n not in results}
        try:
            for future in as_completed(left):
                results[left[future]] = future.result()
                done(len(results))
        finally:
            for future in left:
                future.cancel()

    def close(self) -> None:
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)
            self._pool = None


def _begin() -> None:
    """A process of the pool must not outlive who made it, however that ended."""
    os.nice(NICE)
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # Ctrl-C ends the work at once, without a traceback from each process
    parent = multiprocessing.parent_process()

    def end_with_parent() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=end_with_parent, name="end with parent", daemon=True).start()
