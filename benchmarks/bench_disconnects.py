"""Ten thousand disconnects at random moments: is every link back two seconds after its network, is anything left?

    python -m benchmarks.bench_disconnects --disconnects 10000
    python -m benchmarks.bench_disconnects --disconnects 0 --minutes 10     # a soak

Robots with and without TLS, and pages' WebSockets to a station with a robot, each behind a network of its own that is
cut, reset, stalled, half-open, dead, noisy, slow or late. All in one process, so that its tasks, threads, files,
sockets and children can be counted before and after. Exit code 1 when a link was late or something is left.
"""

from __future__ import annotations

import asyncio
import collections
import contextlib
import gc
import logging
import random
import statistics
import sys
import tempfile
import time
from contextlib import AsyncExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated
from urllib.parse import urlsplit

import psutil
import typer

from benchmarks.disconnect_lines import LagMeter, Line, LinkLine, Return, disturb, link_line, page_line
from tests.link_support import running_robot
from tests.station_support import Film, running_station

BACK_WITHIN_S = 2.0
SETTLE_WITHIN_S = 60.0  # the station pings a page that vanished, and gives it up within that
REPORT_EVERY_S = 60.0


@dataclass
class Tally:
    """What came together."""

    returns: list[Return] = field(default_factory=list)

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


async def run(disconnects: int, minutes: float, links: int, pages: int, seed: int) -> int:
    tally, lag = Tally(), LagMeter()
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
        before = await settled(dict.fromkeys(holdings(), 0), 3.0)
        memory_before = psutil.Process().memory_info().rss
        print(f"{links} links, {pages} pages: {show(before)}, {memory_before / 1e6:.0f} MB", flush=True)

        begin_s = told_s = time.monotonic()
        async with asyncio.TaskGroup() as tasks:
            running = [
                tasks.create_task(disturb(line, random.Random(f"{seed} {line.name}"), lag, tally.returns.append))
                for line in lines
            ]
            goal, end_s = disconnects or float("inf"), begin_s + (minutes * 60 or float("inf"))
            while tally.disconnects < goal and time.monotonic() < end_s:
                await asyncio.sleep(0.5)
                if time.monotonic() - told_s > REPORT_EVERY_S:
                    told_s = time.monotonic()
                    print(f"{told_s - begin_s:5.0f} s: {summary(tally)}", flush=True)
            for task in running:
                task.cancel()
        for line in lines:
            line.proxy.heal()
            await line.proxy.mend()
            line.mark()
        await all_back(lines)
        after = await settled(before, SETTLE_WITHIN_S)
        memory_after = psutil.Process().memory_info().rss
        orphans = sum(line.num_robot_clients - 1 for line in lines if isinstance(line, LinkLine))
        jumbled = [line.name for line in lines if isinstance(line, LinkLine) and not line.counts.is_in_order]
    left = {what: after[what] - before[what] for what in before if after[what] > before[what]}
    print(table(tally))
    print(f"{summary(tally)}, in {time.monotonic() - begin_s:.0f} s, seed {seed}")
    print(f"before: {show(before)}, {memory_before / 1e6:.0f} MB; after: {show(after)}, {memory_after / 1e6:.0f} MB")
    for back in tally.late:
        print(f"LATE: {back}")
    for what, count in left.items():
        print(f"LEFT BEHIND: {count} {what}")
    if orphans:
        print(f"LEFT BEHIND: {orphans} connections in robots")
    if jumbled:
        print(f"IMU samples out of order: {', '.join(jumbled)}")
    return 1 if tally.late or left or orphans or jumbled else 0


async def all_back(lines: list[Line]) -> None:
    async with asyncio.timeout(60):
        while not all(line.is_back for line in lines):
            await asyncio.sleep(0.05)


def summary(tally: Tally) -> str:
    if not tally.returns:
        return "no fault yet"
    back = [r.back_s for r in tally.returns]
    return (
        f"{len(back)} faults, {tally.disconnects} ended a connection; back after {statistics.median(back):.2f} s"
        f" (median), {max(back):.2f} s (longest; event loop late by {max(r.lag_s for r in tally.returns):.2f} s at"
        " most),"
        f" {len(tally.late)} later than {BACK_WITHIN_S:g} s"
    )


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
) -> None:
    """Run and print a table."""
    if not disconnects and not minutes:
        raise typer.BadParameter("give --disconnects or --minutes: one of them must end it")
    logging.basicConfig(level=logging.CRITICAL)
    with contextlib.suppress(KeyboardInterrupt):
        sys.exit(asyncio.run(run(disconnects, minutes, links, pages, seed)))


if __name__ == "__main__":
    typer.run(main)
