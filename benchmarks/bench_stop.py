"""How long the robot moves after a fault, judged at robot-server's serial line and at the motor pins.

    python -m benchmarks.bench_stop            # over an hour; with the same code it goes on where it was ended
    python -m benchmarks.bench_stop --report   # the table of what there is

The page is a WebSocket client, station and robot-server are the real programs, the Mega is the real firmware in the
emulated board in real time. Each fault is one line of a file. Exit code 1 when one breaks a
bound.

What is measured is the robot, not a busy PC: robot-server's stop is stamped in robot-server, and from the moment a
frame reaches the Mega on, only the Mega's own time counts, since a starved emulator lives slower than a Mega. How long
this PC let a waiting process wait stands beside each row. After the stop the joystick stays held, is let go, and where
the fault lasts it is mended: whatever moves in all that time was started by the fault.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import random
import signal
import sys
import time
from dataclasses import replace
from pathlib import Path

from benchmarks.result import Figure, Run, add_results_option, work_folder
from robot.devices.emulated.board import BoardEvent
from tests.support.emulator import board
from tests.support.stopping import firmware as stop_firmware
from tests.support.stopping import report as stop_report
from tests.support.stopping.chain import Chain, LineEntry
from tests.support.stopping.faults import FAULTS, Fault, Instant
from tests.support.stopping.report import PINS_BOUND_MS, SERVER_BOUND_MS, Judged, started_at_us, was_stopped, written_ns

GIVE_UP_S = 3.0  # all waits are in the Mega's time
HELD_S = 0.3  # the joystick is still held after the stop
LET_GO_S = 0.3  # then let go, longer than a command lives
WATCH_S = 0.35  # then the fault is mended


def pins_zero(events: list[BoardEvent], since_us: int) -> BoardEvent | None:
    """The first moment without duty after which there was a moment's rest; None while the motors turn."""
    turning = True
    for event in events:
        if event.text.startswith("pins "):
            turning = event.text != "pins 0 0"
            if not turning and event.t_mega_us >= since_us:
                return event
    return None


def server_stop(log: list[LineEntry]) -> LineEntry | None:
    """The first stop on the serial line after the last drive command."""
    found = None
    for entry in log:
        if entry.what == "drive":
            found = None
        elif entry.what == "stop" and found is None:
            found = entry
    return found


def pins_ms(fault: Fault, instant: Instant, events: list[BoardEvent], log: list[LineEntry], zero: BoardEvent) -> float:
    """From the fault to no duty at the pins.

    Below robot-server: the Mega's own time. Above it: Linux' time until robot-server had written the frame that
    decided, then the Mega's time from that frame's arrival on.
    """
    if not fault.is_above_server:
        return (zero.t_mega_us - instant.mega_us) / 1000
    arrived = [e for e in events if e.text in ("in 10", "in 11") and e.t_mega_us <= zero.t_mega_us]
    drives = [e for e in arrived if e.text == "in 10"]
    if not drives or (drives[-1].t_mega_us < instant.mega_us and arrived[-1].text == "in 10"):
        return (zero.t_mega_us - instant.mega_us) / 1000  # nothing came any more: the firmware's own timer
    stops = [e for e in arrived if e.text == "in 11" and e.t_mega_us >= drives[-1].t_mega_us]
    deciding, what = (stops[0], "stop") if stops else (drives[-1], "drive")
    written = [entry.after_ns for entry in log if entry.what == what and entry.before_ns <= deciding.t_ns]
    if what == "stop" and (stop := server_stop(log)) is not None:
        written = [written_ns(stop, events)]
    linux_ns = max(0, written[-1] - instant.since_ns) if written else deciding.t_ns - instant.since_ns
    return linux_ns * 1e-6 + (zero.t_mega_us - deciding.t_mega_us) / 1000


async def trial(chain: Chain, fault: Fault, rng: random.Random) -> Judged:
    """Drive, break, watch, let go, mend, watch."""
    chain.forget()
    await chain.moving()
    moved_us = await chain.mark()
    await asyncio.sleep(0.06 * rng.random())  # any phase of the 50 ms between two commands
    instant = await fault.inject(chain, rng)
    stopped_before = was_stopped(chain.events(), moved_us, instant.mega_us)
    zero = None
    while zero is None or (fault.is_above_server and server_stop(chain.line_log()) is None):
        if await chain.mark() > instant.mega_us + GIVE_UP_S * 1e6:
            break
        await asyncio.sleep(0.01)
        zero = pins_zero(chain.events(), instant.mega_us)
    stop = server_stop(chain.line_log()) if fault.is_above_server else None
    is_stopped = zero is not None and (stop is not None or not fault.is_above_server)
    ended_ns = time.monotonic_ns()
    assert chain.page is not None
    if zero is not None:
        await chain.pass_mega_s(HELD_S)
    events, log = chain.events(), chain.line_log()
    chain.page.holds = False
    if fault.lasts:
        await chain.pass_mega_s(LET_GO_S)
    mended_us = await chain.mark()
    await mend(chain, fault)
    await chain.pass_mega_s(WATCH_S if fault.lasts else 0.05)
    # From the stop to the end of the trial without a gap.
    again_us = None if zero is None else started_at_us(chain.events(), zero.t_mega_us)
    started = "" if again_us is None else "while it lasted" if again_us <= mended_us else "when it ended"
    if instant.moved:
        started = instant.moved
    return Judged(
        fault.name,
        server_ms=None if stop is None else max(0.0, (written_ns(stop, events) - instant.since_ns) * 1e-6),
        pins_ms=None if zero is None else pins_ms(fault, instant, events, log, zero),
        pins_wall_ms=None if zero is None else (zero.t_ns - instant.since_ns) * 1e-6,
        started=started,
        never_stopped=not is_stopped,
        stopped_before=stopped_before,
        starved_ms=chain.starved_ms(instant.since_ns, ended_ns),
        slipped_ms=chain.slipped_ms(instant.since_ns, ended_ns),
    )


async def mend(chain: Chain, fault: Fault) -> None:
    """End the fault as it ends in life: what was held up on the way flows on."""
    assert chain.robot is not None and chain.station is not None and chain.page is not None
    for process in (chain.robot, chain.station):
        if process.returncode is None:
            with contextlib.suppress(ProcessLookupError):
                chain.signal(process, signal.SIGCONT)
    chain.cable.is_cut = chain.page_cable.is_cut = False
    for clock in chain.clocks.values():
        clock.jump(0.0)
    if fault.name == "serial unplugged":
        chain.board.command("serial 1")
    if fault.name == "camera hung, holds the interpreter":
        chain.let_interpreter_go()
        await chain.logged("unblock")
    if fault.name == "robot-server's loop blocked":
        await chain.tell_robot("go on")
        await chain.logged("unblock")
    with contextlib.suppress(TimeoutError):  # a killed process is told to us a moment later
        await asyncio.wait_for(chain.robot.wait(), 2.0 if fault.name == "robot-server SIGKILL" else 0.001)
    with contextlib.suppress(TimeoutError):
        await asyncio.wait_for(chain.station.wait(), 2.0 if fault.name == "station SIGKILL" else 0.001)
    if chain.robot.returncode is not None:
        await chain.start_robot()
    else:
        await chain.tell_robot("camera normal")
    if chain.station.returncode is not None:
        await chain.kill(chain.station)
        await chain.start_station()
    if not chain.page.is_open:
        await chain.page.close()
        await chain.open_page()


async def run_chain(work: list[Fault], seed: int, results: Path, commit: str) -> None:
    """Faults one after the other; a chain that breaks is made anew."""
    rng = random.Random(seed)
    total, chain, begun_s = len(work), None, time.monotonic()
    try:
        while work:
            fault = work.pop()
            try:
                if chain is None:
                    chain = Chain()
                    await chain.start()
                judged = await trial(chain, fault, rng)
            except (RuntimeError, OSError, TimeoutError) as exc:
                judged = Judged(fault.name, not_judged=f"{type(exc).__name__}: {exc}")
                print(f"\nbench_stop: {fault.name}: {exc!r}; a new chain", file=sys.stderr, flush=True)
            stop_report.append(results, replace(judged, commit=commit))
            if chain is not None and (not judged.is_good or judged.not_judged):
                keep_evidence(chain, judged, results)
            if chain is not None and (judged.not_judged or judged.never_stopped):
                await chain.close()
                chain = None
            done = total - len(work)
            if sys.stderr.isatty() or done % 25 == 0:
                rate = (time.monotonic() - begun_s) / done
                print(
                    f"\rbench_stop: {done}/{total} faults, {rate:.1f} s each ",
                    end="" if sys.stderr.isatty() else "\n",
                    file=sys.stderr,
                    flush=True,
                )
    finally:
        if chain is not None:
            await chain.close()


def keep_evidence(chain: Chain, judged: Judged, results: Path) -> None:
    """What board and line said in a trial that went wrong, for whoever looks into it."""
    with results.with_suffix(".evidence").open("a") as file:
        print(judged, file=file)
        told = [(e.t_ns, f"board {e.t_mega_us} {e.text}") for e in chain.events()]
        told += [(entry.after_ns, f"line {entry.what}") for entry in chain.line_log()]
        for t_ns, text in sorted(told):
            print(f"  {t_ns * 1e-6:.1f} {text}", file=file)
        print(chain.complaints()[-1000:], file=file)


def work_left(counts: dict[str, int], results: list[Judged]) -> dict[str, int]:
    """How many of each kind are still to be done."""
    done = [r.fault for r in results if not r.not_judged]
    return {name: count - done.count(name) for name, count in counts.items() if done.count(name) < count}


async def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scale", type=float, default=1.0, help="share of the full number of faults")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", default="", help="faults whose name holds this")
    parser.add_argument("--part", choices=("all", "chain", "firmware"), default="all", help="run one half by itself")
    parser.add_argument(
        "--rows", type=Path, help="a line per fault; it is added to. Usually in benchmarks/results/work"
    )
    parser.add_argument("--report", action="store_true", help="only print the table of those lines")
    add_results_option(parser, "stop")
    options = parser.parse_args()
    this_run = Run.begin()
    rows = options.rows or work_folder() / "stop.jsonl"
    kinds = {**{f.name: f.count for f in FAULTS}, **stop_firmware.FAULTS}
    counts = {name: max(1, round(n * options.scale)) for name, n in kinds.items() if options.only in name}
    if not options.report:
        if (reason := board.missing_reason()) is not None:
            print(f"bench_stop: {reason}", file=sys.stderr)
            return 1
        board.build()
        await run(options, counts, rows, this_run.state.commit)
    results = stop_report.load(rows)
    print(stop_report.table(results))
    print(stop_report.verdict(results))
    if not options.report:
        this_run.write(options.results, figures(results))
    reasons = stop_report.refusals(results, counts)
    for reason in reasons:
        print(f"bench_stop: {reason}", file=sys.stderr)
    return 0 if results and not reasons and all(r.is_good for r in results) else 1


async def run(options: argparse.Namespace, counts: dict[str, int], rows: Path, commit: str) -> None:
    done = stop_report.load(rows)
    left = work_left(counts, done)
    rng = random.Random(options.seed * 1000 + len(done))
    if options.part != "firmware":
        work = [f for f in FAULTS for _ in range(left.get(f.name, 0))]
        rng.shuffle(work)
        for number in (signal.SIGTERM, signal.SIGINT):  # end with what there is, and leave no process behind
            asyncio.get_running_loop().add_signal_handler(number, work.clear)
        await run_chain(work, rng.randrange(1 << 30), rows, commit)
        for number in (signal.SIGTERM, signal.SIGINT):
            asyncio.get_running_loop().remove_signal_handler(number)
    if options.part != "chain":
        for name in stop_firmware.FAULTS:
            for judged in stop_firmware.run(name, left.get(name, 0), rng):
                stop_report.append(rows, replace(judged, commit=commit))


def figures(results: list[Judged]) -> list[Figure]:
    """What is asked of every fault, over all kinds of them."""
    judged = [r for r in results if not r.not_judged]
    n, kinds = len(judged), len({r.fault for r in judged})
    server_ms = [r.server_ms for r in judged if r.server_ms is not None]
    pins_ms = [r.pins_ms for r in judged if r.pins_ms is not None]
    started, never = sum(bool(r.started) for r in judged), sum(r.never_stopped for r in judged)
    at_server = f"{kinds} kinds of faults: robot-server's stop, slowest"
    return [
        Figure(at_server, max(server_ms, default=None), "ms", SERVER_BOUND_MS, of=len(server_ms)),
        Figure(
            f"{kinds} kinds of faults: motors without power, slowest",
            max(pins_ms, default=None),
            "ms",
            PINS_BOUND_MS,
            of=len(pins_ms),
        ),
        Figure("faults that started a motor", started, at_most=0, of=n),
        Figure("faults after which the motors never stopped", never, at_most=0, of=n),
        Figure("faults that could not be judged", len(results) - n, at_most=0, of=len(results)),
    ]


if __name__ == "__main__":
    sys.exit(asyncio.run(main()))
