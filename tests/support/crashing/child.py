"""A child process that works, says what it was promised and what it was refused, and is killed -9 at some moment."""

from __future__ import annotations

import json
import os
import random
import select
import signal
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, TypeVar

from shared.errors import DataError

T = TypeVar("T")
RETRY_S = 0.02  # after a refusal, as a person's next click would
POLL_S = 0.0005
STUCK_S = 120.0  # a child that says nothing for so long hangs: a fault by itself


class Child:
    """What the work is given, in the child."""

    def __init__(self, pipe: IO[str], seed: int) -> None:
        self._pipe = pipe
        self.rng = random.Random(seed)

    def promise(self, what: object) -> None:
        """From now on this must survive."""
        self._tell({"promised": what})

    def refused(self, sentence: str) -> None:
        """A disk did not take something, and this is what a person read."""
        self._tell({"refused": sentence})

    def do(self, action: Callable[[], T]) -> T:
        """Do it; when it is refused in a sentence, say so and try again. Anything else that is raised is a fault."""
        while True:
            try:
                return action()
            except DataError as exc:
                self.refused(str(exc))
                time.sleep(RETRY_S)

    def _tell(self, said: dict[str, object]) -> None:
        self._pipe.write(json.dumps(said) + "\n")
        self._pipe.flush()


@dataclass(frozen=True)
class Scenario:
    """One kind of work. `work` runs in the child until it is killed; `look` raises AssertionError on any loss."""

    prepare: Callable[[Path], None]  # makes the folder's content; the same every time, so that a copy of it does
    work: Callable[[Path, Child], None]
    look: Callable[[Path, list[object]], str]
    longest_s: float  # the kill comes before
    read: Callable[[Path, list[object]], None]  # what must be readable on a disk that is full or read-only
    write_again: Callable[[Path], None]  # what must work once the disk takes writes again, after `look`
    is_timed: bool = False  # longest_s is by the clock on the wall, else seconds of the child's processor time


@dataclass
class Working:
    """A child at work, seen from its parent."""

    pid: int
    _pipe: int
    promises: list[object] = field(default_factory=list)
    refusals: list[str] = field(default_factory=list)
    _rest: bytes = b""
    _has_ended: bool = False

    def cpu_s(self) -> float:
        """Processor time it has used since it began."""
        return time.clock_gettime((~self.pid << 3) | 2)  # the process' clock (clock_getcpuclockid)

    def wait(self, condition: Callable[[], bool], within_s: float) -> bool:
        """Listen until the condition holds; False when it does not in that time. Raises for a child that ended."""
        deadline_s = time.monotonic() + within_s
        while not condition():
            left_s = deadline_s - time.monotonic()
            if left_s <= 0:
                return False
            self.listen(min(left_s, 0.05))
            assert not self._has_ended, "the child ended by itself"
        return True

    def listen(self, within_s: float) -> None:
        """Take in what it says within that time."""
        if not select.select([self._pipe], [], [], within_s)[0]:
            return
        data = os.read(self._pipe, 65_536)
        self._has_ended |= not data
        *lines, self._rest = (self._rest + data).split(b"\n")
        for line in lines:
            said = json.loads(line)
            if "refused" in said:
                self.refusals.append(said["refused"])
            else:
                self.promises.append(said["promised"])

    def work_for(self, seconds: float, *, is_timed: bool) -> None:
        """Let it work for so long: of its processor time, or by the clock on the wall."""
        begin_s = time.monotonic()
        deadline_s = begin_s + (seconds if is_timed else STUCK_S)
        self.listen(0)
        while time.monotonic() < deadline_s and (is_timed or self.cpu_s() < seconds):
            time.sleep(POLL_S)
            self.listen(0)  # it must never wait for its listener
        assert is_timed or time.monotonic() < deadline_s, f"the child got no {seconds:.2f} s done in {STUCK_S:g} s"

    def kill(self) -> list[object]:
        """Kill -9; what it was promised until then."""
        os.kill(self.pid, signal.SIGKILL)
        while not self._has_ended:
            self.listen(1.0)
        os.close(self._pipe)
        _, status = os.waitpid(self.pid, 0)
        assert os.WIFSIGNALED(status), "the child ended by itself"  # else nothing would have been tried
        return self.promises


def start(work: Callable[[Child], None], seed: int) -> Working:
    """Fork and work. Returns when the child works."""
    reading, writing = os.pipe()
    pid = os.fork()
    if pid == 0:
        try:
            os.close(reading)
            with os.fdopen(writing, "w") as pipe:
                child = Child(pipe, seed)
                child.promise("begun")
                work(child)
        except BaseException:
            traceback.print_exc()
        finally:
            os._exit(1)  # never back into the parent's code
    os.close(writing)
    working = Working(pid, reading)
    assert working.wait(lambda: bool(working.promises), STUCK_S), "the child did not begin"
    del working.promises[0]  # of a machine that is busy the first real ones may have come with it
    return working
