"""What `--help` costs: CPU seconds and peak memory of the programs' help, each the least of three runs.

.venv/bin/python scripts/startup.py
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

RUNS = 3
BIN = Path(sys.executable).parent
CALLS = (
    ("station",),
    ("station", "doctor"),
    ("station", "access"),
    ("station", "serve"),
    ("station", "slam"),
    ("station", "map"),
    ("station", "replay"),
    ("station", "experiment"),
    ("robot-server",),
    ("robot-server", "access"),
)


def cost(words: list[str]) -> tuple[float, float]:
    """CPU seconds (user and system) and peak memory, MB, of one run."""
    silence = [(os.POSIX_SPAWN_OPEN, fd, os.devnull, os.O_WRONLY, 0) for fd in (1, 2)]
    pid = os.posix_spawn(words[0], words, os.environ, file_actions=silence)
    _, status, used = os.wait4(pid, 0)
    if status != 0:
        raise SystemExit(f"{' '.join(words)} ended with status {status}")
    unit = 1024 if sys.platform == "darwin" else 1  # bytes there, kilobytes on Linux
    return used.ru_utime + used.ru_stime, used.ru_maxrss / unit / 1024


def main() -> None:
    print(f"{'command':32s} CPU s    MB")
    for program, *words in CALLS:
        runs = [cost([str(BIN / program), *words, "--help"]) for _ in range(RUNS)]
        name = " ".join([program, *words, "--help"])
        print(f"{name:32s} {min(cpu_s for cpu_s, _ in runs):5.2f} {min(mb for _, mb in runs):5.0f}")


if __name__ == "__main__":
    main()
