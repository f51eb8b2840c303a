"""Lines that are said again and again: told once a minute, with how often they came meanwhile."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable

from shared.text import printable

REPEAT_S = 60.0
MAX_LINES = 256  # that are remembered


class Repetition:
    """Tells which lines are news."""

    def __init__(self, limit: int = MAX_LINES, now_s: Callable[[], float] = time.monotonic) -> None:
        """`limit`: how many different lines may pass in a minute."""
        self._limit = limit
        self._now_s = now_s
        self._lines: dict[str, tuple[float, int]] = {}  # key → when it passed, how often it came since; oldest first
        self._lock = threading.Lock()  # logging asks its filters from any thread

    def news(self, line: str, key: str = "") -> str | None:
        """The line, with how often it was held back before; None: it is held back.

        `key`: what makes it the same line, where that is not its text.
        """
        with self._lock:
            return self._news(line, key or line)

    def _news(self, line: str, key: str) -> str | None:
        now_s = self._now_s()
        passed_s, held = self._lines.get(key, (-REPEAT_S, 0))
        recent = sum(now_s - t_s < REPEAT_S for t_s, _ in self._lines.values())
        if now_s - passed_s < REPEAT_S or recent >= self._limit:
            if key in self._lines:
                self._lines[key] = (passed_s, held + 1)
            return None
        self._lines.pop(key, None)
        self._lines[key] = (now_s, 0)
        if len(self._lines) > MAX_LINES:
            del self._lines[next(iter(self._lines))]
        return f"{line} (and {held} more times since it was told last)" if held else line


class _OncePerMinute(logging.Filter):
    """Holds back repeated warnings and errors; no line can forge another one."""

    def __init__(self) -> None:
        super().__init__()
        self._repetition = Repetition(limit=MAX_LINES + 1)

    def filter(self, record: logging.LogRecord) -> bool:
        line: str | None = printable(record.getMessage())
        if record.levelno >= logging.WARNING and record.exc_info is None:
            line = self._repetition.news(line or "")
        record.msg, record.args = line or "", ()
        return line is not None


def start_logging(level: int, form: str) -> None:
    """Log to stderr; `form` as logging has it."""
    handler = logging.StreamHandler()
    handler.addFilter(_OncePerMinute())
    logging.basicConfig(level=level, format=form, handlers=[handler])
