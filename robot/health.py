"""How the robot itself is: CPU use, temperatures and battery."""

from __future__ import annotations

import time
from pathlib import Path

from robot.devices.ports import Battery
from robot.sensors import Faults
from shared.errors import HardwareError

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


def read_battery(battery: Battery | None, faults: Faults) -> tuple[float | None, float | None]:
    """Voltage and fraction left, as far as known; what keeps it from being read is a fault."""
    if battery is None:
        return None, None
    try:
        state = battery.read()
    except HardwareError as exc:
        faults.set("battery", f"battery: {exc}")
        return None, None
    faults.clear("battery")
    return state.voltage_v, state.fraction
