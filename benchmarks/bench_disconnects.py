"""Ten thousand disconnects at random moments: is every link back two seconds after its network, is anything left?

    python -m benchmarks.bench_disconnects --disconnects 10000
    python -m benchmarks.bench_disconnects --disconnects 0 --minutes 10     # a soak

Robots with and without TLS, and pages' WebSockets to a station with a robot, each behind a network of its own that is
cut, reset, stalled, half-open, dead, noisy, slow or late. All in one process, so that its tasks, threads, files,
sockets and children can be counted before and after. Exit code 1 when a link was late or something is left.

Every fault is a line of a file; Ctrl-C (or SIGTERM) ends with the counts of what is left, and started again with the
same code it goes on, with other moments and faults, until there were enough.
"""

from __future__ import annotations

import asyncio
import collections
import gc
import json
import logging
import random
import signal
import statistics
import tempfile
import time
from contextlib import AsyncExitStack
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, TextIO
from urllib.parse import urlsplit

import psutil
import typer

from benchmarks.disconnect_lines import LagMeter, Line, LinkLine, Return, disturb, link_line, page_line
from benchmarks.result import FOLDER, RESULTS_HELP, Figure, Run, work_folder
from tests.support.link import running_robot
from tests.support.station import Film, running_station

BACK_WITHIN_S = 2.0
SETTLE_WITHIN_S = 60.0  # the station pings a page that vanished, and gives it up within that
REPORT_EVERY_S = 30.0
MAX_POOL_THREADS = 32  # as concurrent.futures sets it


@dataclass
class Tally:
    """What came together, over all runs; each return is a line of a file at once."""

    file: TextIO
    returns: list[Return] = field(default_factory=list)
    left: list[str] = field(default_factory=list)  # what runs left behind, or had out of order, in sentences
    runs: int = 0
    seconds: float = 0.0

    @classmethod
    def of_file(cls, path: Path) -> Tally:
        """What earlier runs wrote there, and room for more."""
        path.parent.mkdir(parents=True, exist_ok=True)
        lines = [json.loads(line) for line in path.read_text().splitlines()] if path.is_file() else []
        tally = cls(path.open("a"))
        for line in lines:
            if "fault" in line:
                tally.returns.append(Return(**line))
            else:
                tally._count_run(**line)
        return tally

    def add(self, back: Return) -> None:
        self.returns.append(back)
        self._write(asdict(back))

    def end_run(self, seconds: float, left: list[str]) -> None:
        self._count_run(seconds, left)
        self._write({"seconds": seconds, "left": left})

    def _count_run(self, seconds: float, left: list[str]) -> None:
        self.runs += 1
        self.seconds += seconds
        self.left += left

    def _write(self, line: dict[str, object]) -> None:
        self.file.write(json.dumps(line) + "\n")
        self.file.flush()

    @property
    def disconnects(self) -> int:
        return sum(back.ended_connection for back in self.returns)

    @property
    def late(self) -> list[Return]:
        """Too late, and not because this process had no processor meanwhile."""
        return [back for back in self.returns if back.back_s - back.lag_s > BACK_WITHIN_S]


def holdings() -> dict[str, int]:
    """What this process holds."""
    gc.collect()
    process = psutil.Process()
    return {
        "tasks": len(asyncio.all_tasks()),
        "threads": process.num_threads(),
        "file descriptors": process.num_fds(),
        "sockets": len(process.net_connections("tcp")),
        "children": len(process.children(recursive=True)),
    }


async def settled(wanted: dict[str, int], within_s: float) -> dict[str, int]:
    """What is held when no more of it goes away."""
    deadline_s = time.monotonic() + within_s
    while True:
        held = holdings()
        if all(held[what] <= wanted[what] for what in held) or time.monotonic() > deadline_s:
            return held
        await asyncio.sleep(0.5)


async def run(tally: Tally, disconnects: int, minutes: float, links: int, pages: int, seed: int) -> None:
    """Go on until there were enough disconnects, or for so long, or until a signal."""
    lag = LagMeter()
    seed += 10_000 * tally.runs  # other moments than those of earlier runs
    async with AsyncExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="disconnects-")))
        lines: list[Line] = [
            await stack.enter_async_context(link_line(f"link {n}", folder, seed + n, has_tls=n % 2 == 1))
            for n in range(links)
        ]
        if pages:
            bench = await stack.enter_async_context(running_robot())
            film = asyncio.create_task(Film(bench).run())
            stack.callback(film.cancel)
            desk = await stack.enter_async_context(running_station(bench.port, folder / "station"))
            port = urlsplit(desk.address).port or 0
            lines += [
                await stack.enter_async_context(page_line(f"page {n}", port, seed + 1000 + n)) for n in range(pages)
            ]
        watch = asyncio.create_task(lag.run())
        stack.callback(watch.cancel)
        await all_back(lines)
        # The event loop's own threads, for names and files, come one by one, and stay.
        await asyncio.gather(*(asyncio.to_thread(time.sleep, 0.2) for _ in range(MAX_POOL_THREADS)))
        before = await settled(dict.fromkeys(holdings(), 0), 3.0)
        memory_before = psutil.Process().memory_info().rss
        print(f"{links} links, {pages} pages: {show(before)}, {memory_before / 1e6:.0f} MB", flush=True)

        begin_s = time.monotonic()
        broken = await disturb_all(tally, lines, lag, disconnects, minutes, seed)
        seconds = time.monotonic() - begin_s
        left = []
        for line in lines:
            line.proxy.heal()
            await line.proxy.mend()
            if not line.finds_garbage:  # its last fault may have been cut short before the connection was
                await line.proxy.reset()
            line.mark()
        if not broken:
            await all_back(lines)
            after = await settled(before, SETTLE_WITHIN_S)
            memory_after = psutil.Process().memory_info().rss
            print(f"after: {show(after)}, {memory_after / 1e6:.0f} MB")
            left = [f"{after[what] - before[what]} {what}" for what in before if after[what] > before[what]]
        orphans = 0 if broken else await orphaned(lines, SETTLE_WITHIN_S)
        if orphans > 0:
            left.append(f"{orphans} connections in robots")
        left += [f"samples out of order in {ln.name}" for ln in lines if isinstance(ln, LinkLine) and not ln.in_order]
    tally.end_run(round(seconds, 1), left + broken)


async def orphaned(lines: list[Line], within_s: float) -> int:
    """Connections beside each station's own that robots still hold when no more of them end: silence ends them."""
    deadline_s = time.monotonic() + within_s
    while True:
        orphans = sum(line.num_robot_clients - 1 for line in lines if isinstance(line, LinkLine))
        if orphans <= 0 or time.monotonic() > deadline_s:
            return orphans
        await asyncio.sleep(0.5)


async def disturb_all(
    tally: Tally, lines: list[Line], lag: LagMeter, disconnects: int, minutes: float, seed: int
) -> list[str]:
    """Returns which lines were broken for good: the first one ends it."""
    begin_s = told_s = time.monotonic()
    end_s = begin_s + (minutes * 60 or float("inf"))
    interrupted = asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, interrupted.set)
    running = [
        asyncio.create_task(disturb(line, random.Random(f"{seed} {line.name}"), lag, tally.add)) for line in lines
    ]
    goal = disconnects or float("inf")
    while tally.disconnects < goal and time.monotonic() < end_s and not interrupted.is_set():
        await asyncio.wait(running, timeout=0.5, return_when=asyncio.FIRST_COMPLETED)
        if any(task.done() for task in running):
            break
        if time.monotonic() - told_s > REPORT_EVERY_S:
            told_s = time.monotonic()
            memory_mb = psutil.Process().memory_info().rss / 1e6
            print(f"{told_s - begin_s:5.0f} s, {memory_mb:.0f} MB: {summary(tally)}", flush=True)
    for task in running:
        task.cancel()
    ends = await asyncio.gather(*running, return_exceptions=True)
    return [str(end) for end in ends if isinstance(end, Exception)]


async def all_back(lines: list[Line]) -> None:
    deadline_s = time.monotonic() + 60
    while away := [line.name for line in lines if not line.is_back]:
        assert time.monotonic() < deadline_s, f"not back after a minute: {', '.join(away)}"
        await asyncio.sleep(0.05)


def summary(tally: Tally) -> str:
    if not tally.returns:
        return "no fault yet"
    back = [r.back_s for r in tally.returns]
    return (
        f"{len(back)} faults, {tally.disconnects} ended a connection; back after {statistics.median(back):.2f} s"
        f" (median), {max(back):.2f} s (longest), {sum(s > BACK_WITHIN_S for s in back)} later than"
        f" {BACK_WITHIN_S:g} s, {len(tally.late)} of them not for want of a processor"
    )


def figures(tally: Tally) -> list[Figure]:
    """Ended connections, how soon they were back, and what was left of them."""
    faults = len(tally.returns)
    late = f"connections back later than {BACK_WITHIN_S:g} s after their network, waits for a processor left out"
    return [
        Figure(late, len(tally.late), at_most=0, of=faults),
        Figure("kinds of things left behind: tasks, threads, files, sockets, …", len(tally.left), at_most=0, of=faults),
    ]


def table(tally: Tally) -> str:
    rows = ["| fault | of | times | ended a connection | back: median / longest s |", "| --- | --- | --- | --- | --- |"]
    groups = collections.defaultdict(list)
    for back in tally.returns:
        groups[back.fault, back.line.split()[0]].append(back)
    for (fault, kind), found in sorted(groups.items()):
        seconds = [back.back_s for back in found]
        ended = sum(back.ended_connection for back in found)
        rows.append(
            f"| {fault} | {kind} | {len(found)} | {ended} | {statistics.median(seconds):.2f} / {max(seconds):.2f} |"
        )
    return "\n".join(rows)


def show(held: dict[str, int]) -> str:
    return ", ".join(f"{count} {what}" for what, count in held.items())


def main(
    disconnects: Annotated[
        int, typer.Option(help="Until so many connections were ended; 0: as long as --minutes says.")
    ] = 10_000,
    minutes: Annotated[float, typer.Option(help="Not longer than this; 0: until there were enough.")] = 0.0,
    links: Annotated[int, typer.Option(help="Robots with a station each; every second one by TLS.")] = 16,
    pages: Annotated[int, typer.Option(help="Pages, of one station.")] = 6,
    seed: Annotated[int, typer.Option(help="Of the moments and faults.")] = 1,
    rows: Annotated[
        Path | None, typer.Option(help="A line per fault; what is in there counts. Usually in benchmarks/results/work.")
    ] = None,
    results: Annotated[Path, typer.Option(help=RESULTS_HELP)] = FOLDER / "disconnects.json",
) -> None:
    """Run and print a table. Exit code 1 when a link was late or something is left."""
    if not disconnects and not minutes:
        raise typer.BadParameter("give --disconnects or --minutes: one of them must end it")
    this_run = Run.begin()
    logging.disable(logging.CRITICAL)  # what garbage does to uvicorn is said by traceback
    tally = Tally.of_file(rows or work_folder() / f"disconnects-{links}-{pages}-{seed}.jsonl")
    if not disconnects or tally.disconnects < disconnects:
        asyncio.run(run(tally, disconnects, minutes, links, pages, seed))
    print(table(tally))
    print(f"{summary(tally)}, in {tally.seconds:.0f} s of {tally.runs} runs")
    this_run.write(results, figures(tally))
    for back in tally.late:
        print(f"LATE: {back}")
    for what in tally.left:
        print(f"LEFT BEHIND: {what}")
    if tally.late or tally.left:
        raise SystemExit(1)


if __name__ == "__main__":
    typer.run(main)
