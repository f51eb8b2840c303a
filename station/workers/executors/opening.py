"""An executor by its address."""

from __future__ import annotations

from shared.advice import install
from shared.errors import ConfigError
from station.config import DASK, PROCESSES, check_executor
from station.workers.executors.port import Executor
from station.workers.executors.processes import ProcessExecutor


def open_executor(address: str = PROCESSES) -> Executor:
    """`processes` (or nothing): of this machine; `dask://HOST:PORT`: a Dask cluster. Raises ConfigError."""
    check_executor(address)
    if not address.startswith(DASK):
        return ProcessExecutor()
    try:
        from station.workers.executors.dask import DaskExecutor
    except ImportError as exc:
        raise ConfigError(f"{address} needs {exc.name}, which is missing; run: {install('station', 'fleet')}") from exc
    return DaskExecutor(f"tcp://{address.removeprefix(DASK)}")
