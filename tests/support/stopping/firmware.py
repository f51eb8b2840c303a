"""Faults at the firmware alone, in the emulator's virtual time: exact, whatever this PC does meanwhile."""

from __future__ import annotations

import random
import tempfile
from collections.abc import Iterator, Sequence
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
AT_ONCE = 20  # faults in one run of the board, where it does not start again
STARTS_AGAIN = "hung"  # by its watchdog; commands for the boot before move nothing then


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


def run(name: str, count: int, rng: random.Random, beside: Sequence[tuple[float, str]] = ()) -> Iterator[Judged]:
    """So many faults of one kind, each when its board has come to its end. `beside`: what else a board is told."""
    at_once = 1 if STARTS_AGAIN in name else AT_ONCE
    for begin in range(0, count, at_once):
        yield from _on_one_board(name, min(at_once, count - begin), rng, beside)


def _on_one_board(name: str, count: int, rng: random.Random, beside: Sequence[tuple[float, str]]) -> list[Judged]:
    script = list(beside)
    faults = []
    for i in range(count):
        start = 1.0 + 1.5 * i
        script += board.drive([start + 0.05 * k for k in range(6)], 600, 600, 300)
        at = start + 0.25 + 0.05 * rng.random()
        faults.append(at)
        script += script_of(name, at)
    with tempfile.TemporaryDirectory() as folder:
        done = board.batch(Path(folder), faults[-1] + 1.5, script)
    moves = [(t_us, bool(left or right)) for t_us, left, right in done.pins]
    return [_judge(name, at * 1e6, moves) for at in faults]


def _judge(name: str, fault_us: float, moves: Sequence[tuple[float, bool]]) -> Judged:
    """`moves`: whenever the pins changed, whether they move anything from then on."""
    before = [moving for t, moving in moves if t <= fault_us]
    if not before or not before[-1]:
        return Judged(name, not_judged="the motors did not turn before it")
    # The next drive command comes 1.2 s after the fault at the earliest.
    after = [(t, moving) for t, moving in moves if fault_us < t < fault_us + 1.1e6]
    zeros = [t for t, moving in after if not moving]
    moved_on = [t for t, moving in after if moving and zeros and t > zeros[0]]
    stop = next((t for t in zeros if not moved_on or t > moved_on[-1]), None)
    return Judged(
        name,
        pins_ms=None if stop is None else (stop - fault_us) / 1000,
        started="while it lasted" if moved_on else "",
        never_stopped=stop is None,
    )
