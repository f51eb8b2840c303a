"""Starts the emulated board (tests/support/emulator) as a process of its own: commands in, events out."""

from __future__ import annotations

import subprocess
import tempfile
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from shared.errors import DeviceLost, DeviceUnavailable

ROOT = Path(__file__).parents[3]
BOARD = ROOT / "firmware" / "build" / "emulator" / "board"
ELF = ROOT / "firmware" / "build" / "sentinel.elf"
START_TIMEOUT_S = 10.0


@dataclass(frozen=True, slots=True)
class BoardEvent:
    """One line of the board: when (the Mega's time and ours) and what."""

    t_mega_us: int
    t_ns: int  # our monotonic clock
    text: str


class EmulatedBoard:
    """A running board. Its serial port is at `port`; the reader thread keeps events and the duty at the motor pins."""

    def __init__(
        self,
        on_pins: Callable[[int, int], None] | None = None,
        folder: Path | None = None,
        keep_events: int = 100_000,
    ) -> None:
        """Starts it.

        Args:
            on_pins: called from the reader thread with left and right duty (permille) on each change.
            folder: where the serial port's link is made; none: a temporary one.
            keep_events: how many of the newest events stay in `events`.
        Raises:
            DeviceUnavailable: not built on this machine.
        """
        for file in (BOARD, ELF):
            if not file.is_file():
                raise DeviceUnavailable(
                    f"the emulated board is not built ({file.name} is missing); run firmware/install-deps.sh and"
                    " make -C firmware emulator"
                )
        self._temporary = tempfile.TemporaryDirectory(prefix="sentinel-board-") if folder is None else None
        self.port = Path(self._temporary.name if self._temporary else folder or ".") / "mega"
        self._on_pins = on_pins
        self.pins = (0, 0)
        self.events: deque[BoardEvent] = deque(maxlen=keep_events)
        self._changed = threading.Condition()
        self.process = subprocess.Popen(
            [str(BOARD), "--elf", str(ELF), "--pty", str(self.port), "--realtime"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            bufsize=1,
        )
        self._write_lock = threading.Lock()
        self._thread = threading.Thread(target=self._read, name="emulated-board", daemon=True)
        self._thread.start()
        if not self.wait_for(lambda: any(e.text == "ready" for e in list(self.events)), START_TIMEOUT_S):
            self.close()
            raise DeviceUnavailable("the emulated board does not start; run make -C firmware emulator")

    def command(self, line: str) -> None:
        """One command of tests/support/emulator/board.c. Raises DeviceLost when the board has ended."""
        assert self.process.stdin is not None
        with self._write_lock:
            try:
                self.process.stdin.write(line + "\n")
                self.process.stdin.flush()
            except (OSError, ValueError) as exc:
                raise DeviceLost(f"the emulated board has ended ({exc})") from exc

    def wait_for(self, condition: Callable[[], bool], timeout_s: float) -> bool:
        """Wait until a condition on events or pins holds. False after the timeout."""
        with self._changed:
            return self._changed.wait_for(condition, timeout_s)

    def close(self) -> None:
        """End it. Safe to call twice."""
        if self.process.poll() is None:
            self.process.terminate()
        self.process.wait(timeout=5)
        self._thread.join(timeout=5)
        for stream in (self.process.stdin, self.process.stdout):
            if stream is not None:
                try:
                    stream.close()
                except BrokenPipeError:
                    continue
        if self._temporary is not None:
            self._temporary.cleanup()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            if not line.startswith("E "):
                continue
            _, t_us, t_ns, text = line.rstrip("\n").split(" ", 3)
            if text.startswith("pins "):
                _, left, right = text.split()
                self.pins = (int(left), int(right))
                if self._on_pins is not None:
                    self._on_pins(*self.pins)
            with self._changed:
                self.events.append(BoardEvent(int(t_us), int(t_ns), text))
                self._changed.notify_all()
