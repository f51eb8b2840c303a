"""What a worker runs and what it can be asked, as types alone: who talks to a worker imports nothing that computes.

A worker runs a *program*, an object that lives in its process. A *request* names a method of the program's interface,
an abstract class that both ends import: what the type checker knows of arguments and answer.
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Generic, ParamSpec, Self, TypeVar

from shared.errors import RobotSystemError

MAX_WAITING = 10_000

EventT = TypeVar("EventT")
ProgramT = TypeVar("ProgramT", bound="Program")
ArgumentsP = ParamSpec("ArgumentsP")
Vectors = Sequence[Sequence[float]]  # (N, 3); lists: the event loop makes no arrays
Method = Callable[..., object]  # of a program's interface


class WorkerDied(RobotSystemError):
    """The worker process ended while it was needed."""


class WorkerFailed(RobotSystemError):
    """The worker raised something that is not one of our errors: a bug."""


@dataclass(frozen=True, slots=True)
class Limit:
    """How much of one kind of request may wait for a busy worker; beyond it the oldest is dropped and counted."""

    count: int = MAX_WAITING
    age_s: float = math.inf  # one that waits longer is dropped when the next of its kind comes


class Program:
    """What runs in a worker's process. Made there, with a function that sends an event to the station."""

    def catch_up(self) -> bool:
        """Do a piece of the work that can wait, while there are no requests; False when none is left."""
        return False


@dataclass(frozen=True, slots=True)
class ProgramName(Generic[ProgramT, EventT]):
    """Where a program is defined. It is imported in the worker's process only, however long that takes."""

    module: str
    name: str

    @classmethod
    def of(cls, program: Callable[[Callable[[EventT], None]], ProgramT]) -> Self:
        """The name of a class that is imported already."""
        return cls(program.__module__, program.__qualname__)

    def load(self) -> Callable[[Callable[[EventT], None]], ProgramT]:
        """Import it. Raises ImportError, AttributeError."""
        make: Callable[[Callable[[EventT], None]], ProgramT] = getattr(importlib.import_module(self.module), self.name)
        return make
