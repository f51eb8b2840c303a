"""Our programs as a person starts them."""

from __future__ import annotations

import asyncio
import re
import resource
import signal
import sys
from asyncio.subprocess import PIPE, Process
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from tests.support.paths import ROOT


@asynccontextmanager
async def program(*words: str, descriptors: int | None = None) -> AsyncIterator[Process]:
    """A module of ours with its arguments, and with so many file descriptors at most."""
    process = await asyncio.create_subprocess_exec(sys.executable, "-m", *words, cwd=ROOT, stdout=PIPE, stderr=PIPE)
    if descriptors is not None:
        resource.prlimit(process.pid, resource.RLIMIT_NOFILE, (descriptors, descriptors))
    try:
        yield process
    finally:
        if process.returncode is None:
            process.send_signal(signal.SIGTERM)
        await asyncio.wait_for(process.communicate(), 60)


async def said(process: Process, pattern: str) -> re.Match[str]:
    """The first line on stdout that fits."""
    assert process.stdout is not None
    while True:
        line = (await asyncio.wait_for(process.stdout.readline(), 120)).decode()
        assert line, f"it ended without saying {pattern}"
        if found := re.search(pattern, line):
            return found
