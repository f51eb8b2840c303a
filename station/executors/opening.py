"""An executor by its address."""

from __future__ import annotations

from shared.advice import install
from shared.errors import ConfigError
from station.executors.port import Executor
from station.executors.processes import ProcessExecutor

DASK = "dask://"
PROCESSES = "processes"


def check_executor(address: str) -> None:
    """Raises ConfigError when it is no address of an executor."""
    host, colon, port = address.removeprefix(DASK).rpartition(":")
    if address in ("", PROCESSES) or (address.startswith(DASK) and colon and host and port.isdecimal()):
        return
    raise ConfigError(f"executor {address!r} is none; give {PROCESSES} or dask://HOST:PORT of a Dask scheduler")


def open_executor(address: str = PROCESSES) -> Executor:
    """`processes` (or nothing): of this machine; `dask://HOST:PORT`: a Dask cluster. Raises ConfigError."""
    check_executor(address)
    if not address.startswith(DASK):
        return ProcessExecutor()
    try:
        from station.executors.dask import DaskExecutor
    except ImportError as exc:
        raise ConfigError(f"{address} needs {exc.name}, which is missing; run: {install('station', 'fleet')}") from exc
    return DaskExecutor(f"tcp://{address.removeprefix(DASK)}")
