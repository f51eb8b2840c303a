"""A bar with the time that went by, for all long work: it fills where something is counted, else it moves."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, ProgressColumn, Task, TextColumn, TimeElapsedColumn
from rich.text import Text


class Bar:
    """What a command says of its work while it goes on."""

    def __init__(self, progress: Progress, description: str) -> None:
        self._progress = progress
        self._begin_s = progress.get_time()
        self._task = progress.add_task(description, total=None)

    def step(self, description: str, total: int | None = None) -> None:
        """Something else is done now; `total` says how often it will `advance`, where that is known."""
        self._progress.remove_task(self._task)  # a task that was counted cannot become one that is not
        self._task = self._progress.add_task(description, total=total)
        self._progress.tasks[-1].start_time = self._begin_s

    def advance(self, description: str | None = None) -> None:
        """One more is done."""
        self._progress.update(self._task, advance=1, description=description)

    def reach(self, done_s: float, total_s: float) -> None:
        """So much of recorded time is done."""
        self._progress.update(self._task, completed=done_s, total=total_s, unit=" s")


class Count(ProgressColumn):
    """How much of how much, where it is counted."""

    def render(self, task: Task) -> Text:
        unit = task.fields.get("unit", "")
        return Text("" if task.total is None else f"{task.completed:.0f}/{task.total:.0f}{unit}")


@contextmanager
def working(description: str) -> Iterator[Bar]:
    """Show on stderr that work goes on; nothing where stderr is no terminal, and nothing is left of it at the end."""
    columns = (TextColumn("{task.description}"), BarColumn(), Count(), TimeElapsedColumn())
    console = Console(stderr=True)
    with Progress(*columns, console=console, disable=not sys.stderr.isatty(), transient=True) as progress:
        yield Bar(progress, description)
