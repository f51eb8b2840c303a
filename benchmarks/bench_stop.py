"""How long the robot moves after a fault, judged at robot-server's motors and at the motor pins.

    python -m benchmarks.bench_stop [--scale 1.0] [--chains 2] [--seed 1]

The page is a WebSocket client, station and robot-server are the real programs, the Mega is the real firmware in the
emulated board in real time. Firmware faults are injected in virtual time. The result is a table on stdout and
benchmarks/results/stop.json; exit code 1 when a bound is broken.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import platform
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Awaitable, Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

from benchmarks.stop_chain import Chain, Page  # noqa: E402
from shared import serial_protocol as sp  # noqa: E402
from tests.emulator import board  # noqa: E402

SERVER_BOUND_MS, PINS_BOUND_MS = 300.0, 500.0
WATCH_S = 0.6  # after the stop: nothing may start again
GIVE_UP_S = 3.0

Inject = Callable[[Chain, random.Random], Awaitable[int]]  # returns since when the robot must stop, ns


async def page_closed(chain: Chain, _rng: random.Random) -> int:
    assert chain.page is not None
    now = time.monotonic_ns()
    chain.page.vanish()
    return now


async def page_frozen(chain: Chain, _rng: random.Random) -> int:
    assert chain.page is not None
    chain.page.holds = False  # the connection stays, nothing comes
    return time.monotonic_ns()


async def network_cut(chain: Chain, _rng: random.Random) -> int:
    chain.cable.is_cut = True
    return time.monotonic_ns()


def killing(who: str, number: int) -> Inject:
    async def inject(chain: Chain, _rng: random.Random) -> int:
        now = time.monotonic_ns()
        chain.signal(getattr(chain, who), number)
        return now

    return inject


async def loop_blocked(chain: Chain, rng: random.Random) -> int:
    await chain.tell_robot(f"{rng.choice(['block', 'sleep'])} 4")
    return time.monotonic_ns()


async def serial_unplugged(chain: Chain, _rng: random.Random) -> int:
    now = time.monotonic_ns()
    chain.board.command("serial 0")
    return now


def then_silent(line: str) -> Inject:
    """A fault that need not stop a driven robot; it must not keep it from stopping once the driver is silent."""

    async def inject(chain: Chain, rng: random.Random) -> int:
        await chain.tell_robot(line)
        await asyncio.sleep(0.1 + 0.1 * rng.random())
        return await page_frozen(chain, rng)

    return inject


async def two_drivers(chain: Chain, rng: random.Random) -> int:
    other = Page(chain.address, "other", -0.3)
    await other.open()
    other.holds = True
    await asyncio.sleep(0.15 + 0.1 * rng.random())
    if min(chain.board.pins) < 0:
        raise RuntimeError("the second driver moved the robot")
    await other.close()
    return await page_frozen(chain, rng)


@dataclass(frozen=True)
class Fault:
    """One row of the table."""

    name: str
    count: int
    inject: Inject
    judged_at_server: bool = True


FAULTS = [
    Fault("page closed", 120, page_closed),
    Fault("page frozen", 120, page_frozen),
    Fault("network cut (half-open)", 60, network_cut),
    Fault("station SIGKILL", 15, killing("station", signal.SIGKILL)),
    Fault("station SIGSTOP", 70, killing("station", signal.SIGSTOP)),
    Fault("robot-server's loop blocked", 70, loop_blocked),
    Fault("robot-server SIGSTOP", 80, killing("robot", signal.SIGSTOP), judged_at_server=False),
    Fault("robot-server SIGKILL", 40, killing("robot", signal.SIGKILL), judged_at_server=False),
    Fault("serial unplugged", 60, serial_unplugged, judged_at_server=False),
    Fault("camera hung, driver silent", 70, then_silent("camera hang")),
    Fault("flood of frames, driver silent", 70, then_silent("camera flood")),
    Fault("two drivers, both silent", 70, two_drivers),
    Fault("wall clock jumped, driver silent", 70, then_silent("clock 86400")),
]
FIRMWARE_FAULTS = {
    "line silent": 150,
    "only damaged frames": 150,
    "flood of other frames": 100,
    "hung, interrupts on": 100,
    "hung, interrupts off": 100,
    "I2C bus stuck, line silent": 100,
}


@dataclass
class Row:
    """Measured milliseconds of one kind of fault."""

    name: str
    server_ms: list[float] = field(default_factory=list)
    pins_ms: list[float] = field(default_factory=list)
    restarted: int = 0  # a motor started again after the fault
    failed: int = 0  # did not stop within GIVE_UP_S
    slipped: int = 0  # the emulated board could not keep up with the clock meanwhile: its wall times are too long

    def summary(self) -> dict[str, object]:
        return {
            "fault": self.name,
            "count": len(self.pins_ms) + self.failed,
            "server_max_ms": max(self.server_ms, default=None),
            "server_p99_ms": percentile(self.server_ms),
            "pins_max_ms": max(self.pins_ms, default=None),
            "pins_p99_ms": percentile(self.pins_ms),
            "restarted": self.restarted,
            "never_stopped": self.failed,
            "board_slipped": self.slipped,
        }

    @property
    def is_within_bounds(self) -> bool:
        return (
            self.restarted == self.failed == 0
            and max(self.server_ms, default=0) <= SERVER_BOUND_MS
            and max(self.pins_ms, default=0) <= PINS_BOUND_MS
        )


def percentile(values: list[float], share: float = 0.99) -> float | None:
    """The smallest value that at least `share` of all do not exceed."""
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, -int(-share * len(ordered) // 1) - 1)] if ordered else None


async def trial(chain: Chain, fault: Fault, row: Row, rng: random.Random) -> None:
    """Drive, break, watch, mend."""
    await chain.moving()
    await asyncio.sleep(0.1 * rng.random())
    since_ns = await fault.inject(chain, rng)
    give_up_ns = since_ns + round(GIVE_UP_S * 1e9)
    pins_ns, server_ns = None, None
    while time.monotonic_ns() < give_up_ns:
        pins_ns = chain.pins_zero_ns(since_ns)
        server_ns = chain.server_stop_ns(since_ns) if fault.judged_at_server else None
        if pins_ns is not None and (server_ns is not None or not fault.judged_at_server):
            break
        await asyncio.sleep(0.01)
    if pins_ns is None or (fault.judged_at_server and server_ns is None):
        row.failed += 1
    else:
        await asyncio.sleep(WATCH_S)
        again = chain.pins_zero_ns(since_ns)
        row.restarted += again is None or abs(again - pins_ns) > 2_000_000
        row.pins_ms.append((pins_ns - since_ns) * 1e-6)
        row.slipped += chain.slips_between(since_ns, pins_ns) > 0
        if server_ns is not None:
            row.server_ms.append((server_ns - since_ns) * 1e-6)


async def mend(chain: Chain) -> None:
    """Everything as before the fault."""
    assert chain.robot is not None and chain.station is not None and chain.page is not None
    for process in (chain.robot, chain.station):
        if process.returncode is None:
            try:
                chain.signal(process, signal.SIGCONT)
            except ProcessLookupError:
                continue
    await chain.page.close()
    if chain.cable.is_cut:
        chain.cable.mend()
    chain.board.command("serial 1")
    await asyncio.sleep(0.05)
    if chain.robot.returncode is not None:
        await chain.start_robot()
    else:
        await chain.tell_robot("camera normal")
        await chain.tell_robot("clock 0")
    if chain.station.returncode is not None:
        await chain.kill(chain.station)
        await chain.start_station()
    await chain.open_page()


async def run_chain(work: list[Fault], rows: dict[str, Row], seed: int, progress: Callable[[], None]) -> None:
    """Faults one after the other on one chain; a chain that breaks is made anew."""
    rng = random.Random(seed)
    chain = Chain()
    try:
        await chain.start()
        while work:
            fault = work.pop()
            try:
                judged = False
                await trial(chain, fault, rows[fault.name], rng)
                judged = True
                await mend(chain)
            except (RuntimeError, OSError, TimeoutError) as exc:
                when = "mending after it" if judged else "it"
                print(f"bench_stop: {fault.name}: {when}: {exc}; a new chain", file=sys.stderr, flush=True)
                print(chain.complaints(), file=sys.stderr, flush=True)
                rows[fault.name].failed += not judged
                await chain.close()
                chain = Chain()
                await chain.start()
            progress()
    finally:
        await chain.close()


def firmware_fault(name: str, at: float) -> list[tuple[float, str]]:
    """Script lines that break something at a time, and mend it before the next."""
    again = [at + 0.02 * k for k in range(50)]
    if name == "only damaged frames":
        bad = bytearray(sp.encode(sp.Drive(600, 600, 300)))
        bad[3] ^= 0x10
        return [(t, f"uart {bad.hex()}") for t in again]
    if name == "flood of other frames":
        return [(t, "uart " + sp.encode(sp.AskTime(1)).hex() * 40) for t in again]
    if name.startswith("hung"):
        return [(at, "hang off" if name.endswith("off") else "hang on")]
    if name.startswith("I2C"):
        return [(at, "bus_stuck -1"), (at + 0.9, "bus_stuck 0")]
    return []


def firmware_rows(scale: float, seed: int) -> list[Row]:
    """Faults at the firmware alone, in virtual time: exact, whatever this PC does meanwhile."""
    rng = random.Random(seed)
    rows = []
    for name, count in FIRMWARE_FAULTS.items():
        script: list[tuple[float, str]] = []
        faults = []
        for i in range(max(2, round(count * scale))):
            start = 1.0 + 1.5 * i
            script += board.drive([start + 0.05 * k for k in range(6)], 600, 600, 300)
            at = start + 0.25 + 0.05 * rng.random()
            faults.append(at)
            script += firmware_fault(name, at)
        row = Row(f"firmware: {name}")
        with tempfile.TemporaryDirectory() as folder:
            run = board.batch(Path(folder), faults[-1] + 1.5, script)
        for at in faults:
            moving = [t for t, left, right in run.pins if (left or right) and at * 1e6 < t < (at + 1.0) * 1e6]
            after = moving[-1] if moving else at * 1e6
            zeros = [t for t, left, right in run.pins if not (left or right) and t > after]
            row.pins_ms.append((zeros[0] - at * 1e6) / 1000 if zeros else 1e9)
        rows.append(row)
    return rows


def table(rows: list[Row]) -> str:
    """Markdown."""

    def cell(value: object) -> str:
        return f"{value:.0f}" if isinstance(value, float) else "-"

    lines = [
        "| fault | count | robot-server max | p99 | pins max | p99 | started again | never stopped | board slipped |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for row in rows:
        s = row.summary()
        times = " | ".join(cell(s[k]) for k in ("server_max_ms", "server_p99_ms", "pins_max_ms", "pins_p99_ms"))
        ends = " | ".join(str(s[k]) for k in ("restarted", "never_stopped", "board_slipped"))
        lines.append(f"| {s['fault']} | {s['count']} | {times} | {ends} |")
    return "\n".join(lines)


async def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scale", type=float, default=1.0, help="share of the full number of faults")
    parser.add_argument("--chains", type=int, default=2, help="chains at once")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", default="", help="faults whose name holds this")
    parser.add_argument("--part", choices=("all", "chain", "firmware"), default="all", help="run one half by itself")
    options = parser.parse_args()
    if (reason := board.missing_reason()) is not None:
        print(f"bench_stop: {reason}", file=sys.stderr)
        return 1
    board.build()
    faults = [f for f in FAULTS if options.only in f.name and options.part != "firmware"]
    rows = {f.name: Row(f.name) for f in faults}
    work = [f for f in faults for _ in range(max(1, round(f.count * options.scale)))]
    random.Random(options.seed).shuffle(work)
    total, done = len(work), 0

    def progress() -> None:
        nonlocal done
        done += 1
        if sys.stderr.isatty() or done % 25 == 0:
            print(f"\rbench_stop: {done}/{total} faults", end="" if sys.stderr.isatty() else "\n", file=sys.stderr)

    for number in (signal.SIGTERM, signal.SIGINT):  # end with what there is, and leave no process behind
        asyncio.get_running_loop().add_signal_handler(number, work.clear)
    chains = [run_chain(work, rows, options.seed * 1000 + i, progress) for i in range(options.chains if work else 0)]
    await asyncio.gather(*chains)
    everything = [*rows.values(), *(firmware_rows(options.scale, options.seed) if options.part != "chain" else [])]
    print(table(everything))
    commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, cwd=ROOT).stdout
    result = {
        "seed": options.seed,
        "commit": commit.strip(),
        "python": platform.python_version(),
        "load": os.getloadavg(),
        "rows": [row.summary() for row in everything],
        "samples": [asdict(row) for row in everything],
    }
    folder = ROOT / "benchmarks" / "results"
    folder.mkdir(parents=True, exist_ok=True)
    name = "stop.json" if options.part == "all" else f"stop_{options.part}.json"
    (folder / name).write_text(json.dumps(result, indent=1))
    num = sum(len(row.pins_ms) + row.failed for row in everything)
    good = all(row.is_within_bounds for row in everything)
    print(f"{num} faults, {'all within' if good else 'NOT all within'} {SERVER_BOUND_MS:.0f}/{PINS_BOUND_MS:.0f} ms")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(asyncio.run(main()))
