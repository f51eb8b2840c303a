"""How soon a station with access control answers STOP while strangers who have no token do their worst.

    python -m benchmarks.bench_strangers [--seconds 20] [--results FILE]

The station is a program with 256 file descriptors; the strangers are a process of their own on the same machine, so
they also take its processor. Each STOP is a new connection: TCP, TLS, request, answer. No robot is there, so the answer
(503, in words) is the station's alone.
"""

from __future__ import annotations

import argparse
import asyncio
import itertools
import json
import multiprocessing
import ssl
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
from typer.testing import CliRunner

from benchmarks.result import Figure, Run, add_results_option
from station.access.visitors import access_folder
from station.main import app
from tests.support.programs import program, said

STOP_MS = 200.0
STOP_EVERY_S = 0.1
WITHIN_S = 5.0  # an answer later than that counts as none
DESCRIPTORS = 256
HELD = 240  # unfinished bodies
AT_ONCE = 32  # strangers of a flood, from eight addresses
GARBAGE = b"\0"  # no TLS begins so
BODY = b"POST /login HTTP/1.1\r\nHost: s\r\nContent-Type: application/json\r\nContent-Length: 4000\r\n\r\n"
REQUEST = b"POST /stop HTTP/1.1\r\nHost: s\r\nContent-Length: 0\r\n\r\n"
NOBODY = "nobody else"
BODIES, CONNECTIONS, WORDS, HANDSHAKES, REQUESTS = (
    f"{HELD} unfinished bodies",
    "a flood of connections",
    "a flood of connections that say a byte",
    "a flood of TLS handshakes",
    "a flood of requests",
)
STRANGERS = (NOBODY, BODIES, CONNECTIONS, WORDS, HANDSHAKES, REQUESTS)


async def trouble(what: str, host: str, port: int) -> None:
    """Until the process is ended."""
    tls = ssl.create_default_context()
    tls.check_hostname, tls.verify_mode = False, ssl.CERT_NONE
    count = HELD if what == BODIES else AT_ONCE
    await asyncio.gather(*(_trouble(what, host, port, tls, n) for n in range(count)))


async def _trouble(what: str, host: str, port: int, tls: ssl.SSLContext, number: int) -> None:
    while True:
        try:
            async with asyncio.timeout(WITHIN_S):
                # Each kind's own: a closed connection keeps its port for a minute.
                source = (f"127.0.{STRANGERS.index(what)}.{2 + number % 8}", 0)
                reader, writer = await asyncio.open_connection(
                    host, port, ssl=None if what in (CONNECTIONS, WORDS) else tls, local_addr=source
                )
                if what == WORDS:
                    writer.write(GARBAGE)
                if what == BODIES:
                    writer.write(BODY)
                    await reader.read()
                while what == REQUESTS:
                    writer.write(REQUEST)
                    if not await reader.read(65536):
                        break
                writer.transport.abort()
        except (OSError, TimeoutError):
            await asyncio.sleep(0.01)


def _run_trouble(what: str, host: str, port: int) -> None:
    asyncio.run(trouble(what, host, port))


@contextmanager
def strangers(what: str, host: str, port: int) -> Iterator[None]:
    if what == NOBODY:
        yield
        return
    process = multiprocessing.get_context("spawn").Process(target=_run_trouble, args=(what, host, port))
    process.start()
    try:
        yield
    finally:
        process.terminate()
        process.join()


async def stop_once(host: str, port: int, tls: ssl.SSLContext, token: str) -> float:
    """Milliseconds until the answer; infinite where none came."""
    begun = time.monotonic()
    try:
        async with asyncio.timeout(WITHIN_S):
            reader, writer = await asyncio.open_connection(host, port, ssl=tls)
            head = f"POST /stop HTTP/1.1\r\nHost: {host}\r\nAuthorization: Bearer {token}\r\nContent-Length: 0\r\n\r\n"
            writer.write(head.encode())
            status = await reader.readline()
            writer.transport.abort()
    except (OSError, TimeoutError):
        return float("inf")
    return (time.monotonic() - begun) * 1e3 if b" 503 " in status else float("inf")


async def measure(seconds: float) -> list[Figure]:
    found: list[Figure] = []
    with tempfile.TemporaryDirectory() as folder:
        made = CliRunner().invoke(app, ["access", "init", "--data", folder, "--json"])
        token = json.loads(made.stdout)["token"]
        config = Path(folder) / "station.toml"
        config.write_text("[access]\non_loopback = true\n")
        words = ("serve", "--robot", "127.0.0.1:1", "--port", "0", "--data", folder, "--config", str(config))
        async with program("station.main", *words, descriptors=DESCRIPTORS) as process:
            at = urlsplit((await said(process, r"(https://\S+)"))[1])
            assert at.hostname is not None and at.port is not None
            tls = ssl.create_default_context(cafile=str(access_folder(Path(folder)) / "certificate.pem"))
            for what in STRANGERS:
                with strangers(what, at.hostname, at.port):
                    await asyncio.sleep(3.0)  # until they are at work
                    delays_ms = await stops(at.hostname, at.port, tls, token, seconds)
                found += figures(what, delays_ms)
    return found


async def stops(host: str, port: int, tls: ssl.SSLContext, token: str, seconds: float) -> list[float]:
    end = time.monotonic() + seconds
    delays_ms = []
    for _ in itertools.takewhile(lambda _: time.monotonic() < end, itertools.count()):
        delays_ms.append(await stop_once(host, port, tls, token))
        await asyncio.sleep(STOP_EVERY_S)
    return delays_ms


def figures(what: str, delays_ms: list[float]) -> Iterator[Figure]:
    num = len(delays_ms)
    for name, percent in (("median", 50), ("99 %", 99)):
        value = float(np.percentile(delays_ms, percent, method="higher"))
        yield Figure(f"STOP beside {what}: answered, {name}", value if value < np.inf else None, "ms", STOP_MS, of=num)
    unanswered = sum(delay == np.inf for delay in delays_ms)
    yield Figure(f"STOP beside {what}: not answered", unanswered, at_most=0, of=num)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=20.0, help="beside each kind of strangers")
    add_results_option(parser, "strangers")
    options = parser.parse_args()
    run = Run.begin()
    found = asyncio.run(measure(options.seconds))
    for figure in found:
        value = "–" if figure.value is None else f"{figure.value:.4g} {figure.unit}".strip()
        print(f"{figure.what}: {value} (n = {figure.of}){'' if figure.is_met else '   (not met)'}")
    run.write(options.results, found)


if __name__ == "__main__":
    main()
