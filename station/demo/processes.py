"""Child programs of the demo: started together, logged to files, ended newest first."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
from pathlib import Path
from types import TracebackType
from typing import IO

from shared.errors import RobotSystemError

END_TIMEOUT_S = 10.0


def free_port() -> int:
    """A loopback TCP port nobody listens on right now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


class Programs:
    """Named child processes; leaving the context ends those that still run, newest first."""

    def __init__(self, log_dir: Path) -> None:
        self._log_dir = log_dir
        self._running: dict[str, tuple[subprocess.Popen[bytes], IO[bytes]]] = {}

    def __enter__(self) -> Programs:
        self._log_dir.mkdir(parents=True, exist_ok=True)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        # A second Ctrl-C must not leave programs behind: ending them is bounded in time.
        before = {number: signal.signal(number, signal.SIG_IGN) for number in (signal.SIGINT, signal.SIGTERM)}
        try:
            for name in reversed(list(self._running)):
                self.end(name)
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)

    def start(self, name: str, module: str, *arguments: str) -> None:
        """Run `python -m module arguments` with its output in LOG_DIR/name.log."""
        log = (self._log_dir / f"{name}.log").open("wb")
        environment = os.environ | {"PYTHONUNBUFFERED": "1"}
        # A session of its own: Ctrl-C reaches only the demo, which then ends its programs in order.
        process = subprocess.Popen(
            [sys.executable, "-m", module, *arguments],
            stdout=log,
            stderr=subprocess.STDOUT,
            stdin=subprocess.DEVNULL,
            env=environment,
            start_new_session=True,
        )
        self._running[name] = (process, log)

    def check(self, may_end: str = "") -> None:
        """Raise when a program has failed, or has ended although it should run (all but `may_end`)."""
        for name, (process, _) in self._running.items():
            code = process.poll()
            if code is not None and (code != 0 or name != may_end):
                raise RobotSystemError(f"{name} ended with code {process.returncode}: {self.last_words(name)}")

    def wait(self, name: str, timeout_s: float) -> int:
        """Wait for a program that ends by itself; its exit code."""
        process, log = self._running[name]
        try:
            code = process.wait(timeout_s)
        except subprocess.TimeoutExpired as exc:
            raise RobotSystemError(f"{name} did not end within {timeout_s:.0f} s; see {log.name}") from exc
        del self._running[name]
        log.close()
        if code != 0:
            raise RobotSystemError(f"{name} ended with code {code}: {self.last_words(name)}")
        return code

    def pid(self, name: str) -> int:
        """The process id of a running program."""
        return self._running[name][0].pid

    def is_known(self, name: str) -> bool:
        """Whether the program was started and neither waited for nor ended."""
        return name in self._running

    def end(self, name: str) -> None:
        """Ask a program to end; kill it when it does not."""
        process, log = self._running.pop(name)
        if process.poll() is None:
            process.send_signal(signal.SIGTERM)
            try:
                process.wait(END_TIMEOUT_S)
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()
        log.close()

    def last_words(self, name: str) -> str:
        """The last line a program logged."""
        lines = (self._log_dir / f"{name}.log").read_text(errors="replace").strip().splitlines()
        return lines[-1] if lines else "it said nothing"
