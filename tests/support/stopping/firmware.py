"""Faults at the firmware alone, in the emulator's virtual time: exact, whatever this PC does meanwhile."""

from __future__ import annotations

import random
import tempfile
from pathlib import Path

from shared import serial_protocol as sp
from tests.support.emulator import board
from tests.support.stopping.report import Judged

FAULTS = {
    "firmware: line silent": 120,
    "firmware: only damaged frames": 120,
    "firmware: flood of other frames": 80,
    "firmware: hung, interrupts on": 80,
    "firmware: hung, interrupts off": 80,
    "firmware: I2C bus stuck, line silent": 80,
}
AT_ONCE = 20  # faults in one run of the board


def script_of(name: str, at: float) -> list[tuple[float, str]]:
    """Script lines that break something at a time, and mend it before the next."""
    again = [at + 0.02 * k for k in range(50)]
    if "damaged" in name:
        bad = bytearray(sp.encode(sp.Drive(600, 600, round(1000 * at) + 1000, 1)))
        bad[3] ^= 0x10
        return [(t, f"uart {bad.hex()}") for t in again]
    if "flood" in name:
        return [(t, "uart " + sp.encode(sp.AskTime(1)).hex() * 40) for t in again]
    if "hung" in name:
        return [(at, "hang off" if name.endswith("off") else "hang on")]
    if "I2C" in name:
        return [(at, "bus_stuck -1"), (at + 0.9, "bus_stuck 0")]
    return []


def run(name: str, count: int, rng: random.Random) -> list[Judged]:
    """So many faults of one kind in one run."""
    script: list[tuple[float, str]] = []
    faults = []
    for i in range(count):
        start = 1.0 + 1.5 * i
        script += board.drive([start + 0.05 * k for k in range(6)], 600, 600, 300)
        at = start + 0.25 + 0.05 * rng.random()
        faults.append(at)
        script += script_of(name, at)
    with tempfile.TemporaryDirectory() as folder:
        done = board.batch(Path(folder), faults[-1] + 1.5, script)
    results = []
    for at in faults:
        # The next drive command comes 1.2 s after the fault at the earliest.
        after = [(t, left or right) for t, left, right in done.pins if at * 1e6 < t < (at + 1.1) * 1e6]
        zeros = [t for t, moves in after if not moves]
        first = zeros[0] if zeros else None
        moved_on = [t for t, moves in after if moves and first is not None and t > first]
        stop = next((t for t in zeros if not moved_on or t > moved_on[-1]), None)
        results.append(
            Judged(
                name,
                pins_ms=None if stop is None else (stop - at * 1e6) / 1000,
                started="while it lasted" if moved_on else "",
                never_stopped=stop is None,
            )
        )
    return results
