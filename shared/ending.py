"""Which signals end a program in good order."""

from __future__ import annotations

import signal


def ending_signals() -> list[signal.Signals]:
    """SIGINT, SIGTERM, and SIGHUP (its terminal was closed) unless it was started to outlive that, as `nohup` does."""
    is_immune = signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    return [signal.SIGINT, signal.SIGTERM, *([] if is_immune else [signal.SIGHUP])]
