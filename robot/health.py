"""How the robot's computer is: CPU use and temperatures."""

from __future__ import annotations

import time
from pathlib import Path

THERMAL_ZONES = Path("/sys/class/thermal")


class CpuMeter:
    """CPU use of this process since the last second or more."""

    def __init__(self) -> None:
        self._wall_s, self._cpu_s = time.monotonic(), time.process_time()
        self._percent = 0.0

    def percent(self) -> float:
        """Of one core; measured over at least half a second."""
        wall_s, cpu_s = time.monotonic(), time.process_time()
        if wall_s - self._wall_s >= 0.5:
            self._percent = 100.0 * (cpu_s - self._cpu_s) / (wall_s - self._wall_s)
            self._wall_s, self._cpu_s = wall_s, cpu_s
        return self._percent


def read_temperatures() -> dict[str, float]:
    """Zone → °C as Linux gives them; empty where it gives none."""
    temperatures = {}
    for zone in sorted(THERMAL_ZONES.glob("thermal_zone*"))[:8]:
        try:
            name = (zone / "type").read_text().strip()
            temperatures[name] = int((zone / "temp").read_text()) / 1000.0
        except (OSError, ValueError):
            continue
    return temperatures
