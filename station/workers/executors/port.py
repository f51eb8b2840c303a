"""What heavy work needs of the machines it runs on."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from types import TracebackType
from typing import Protocol, Self, TypeVar

from shared.errors import RobotSystemError

P = TypeVar("P")
R = TypeVar("R")
MAX_TRIES = 4  # of a piece whose worker dies: one that kills its workers itself must not do so for ever


class ExecutorFailed(RobotSystemError):
    """The machines that should do the work cannot, or died of it again and again."""


class Executor(Protocol):
    """Does pieces of heavy work. A piece may run twice, anywhere: its result depends on nothing but the piece."""

    @property
    def shares_disk(self) -> bool:
        """Whether a path of ours means the same where the work is done."""
        ...

    def map(
        self, function: Callable[[P], R], pieces: Sequence[P], done: Callable[[int], None] = lambda _: None
    ) -> list[R]:
        """The results, in the order of the pieces. `function` is a top-level one; `done` hears how many are done.

        Raises what a piece raised, or ExecutorFailed.
        """
        ...

    def close(self) -> None: ...

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


class Closing(ABC):
    """An executor is closed at the end of its `with`."""

    @abstractmethod
    def close(self) -> None: ...

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
