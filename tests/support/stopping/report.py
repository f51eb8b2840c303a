"""One line per injected fault in a results file, and the table made of them."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path

from robot.devices.emulated.board import BoardEvent
from tests.support.stopping.chain import LineEntry

SERVER_BOUND_MS, PINS_BOUND_MS = 300.0, 500.0


@dataclass(frozen=True)
class Judged:
    """What one fault did. Times are milliseconds from the fault on; None where a figure does not apply."""

    fault: str
    server_ms: float | None = None  # until robot-server had written its stop to the serial line
    pins_ms: float | None = None  # until no duty at the motor pins: Linux' part by its clock, the Mega's by its own
    pins_wall_ms: float | None = None  # the same by this PC's clock alone, waits of a starved emulator included
    started: str = ""  # "": nothing moved any more. Otherwise when: "while it lasted" or "when it ended"
    never_stopped: bool = False
    stopped_before: bool = False  # the motors were, after they were driven for this trial and before its fault
    not_judged: str = ""  # the chain broke for a reason of its own; says which
    starved_ms: float = 0.0  # the longest a waiting process had to wait for a core meanwhile
    slipped_ms: float = 0.0  # by how much the emulated Mega fell behind the clock meanwhile
    commit: str = ""

    @property
    def is_good(self) -> bool:
        return (
            not self.not_judged
            and not self.started
            and not self.never_stopped
            and (self.server_ms or 0.0) <= SERVER_BOUND_MS
            and (self.pins_ms or 0.0) <= PINS_BOUND_MS
        )


def append(path: Path, judged: Judged) -> None:
    """Add a line; what is in the file survives the end of this process."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a") as file:
        file.write(json.dumps(asdict(judged)) + "\n")


def load(path: Path) -> list[Judged]:
    """All lines of a results file; a torn last one is left out."""
    if not path.exists():
        return []
    found = []
    for line in path.read_text().splitlines():
        try:
            found.append(Judged(**json.loads(line)))
        except ValueError:
            continue
    return found


def percentile(values: list[float], share: float) -> float | None:
    """The smallest value that at least `share` of all do not exceed."""
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, -int(-share * len(ordered) // 1) - 1)] if ordered else None


def _figures(values: Iterable[float | None]) -> str:
    known = [v for v in values if v is not None]
    parts = (percentile(known, 0.5), percentile(known, 0.99), max(known, default=None))
    return " / ".join("-" if v is None else f"{v:.0f}" for v in parts) if known else "-"


def table(results: list[Judged]) -> str:
    """Markdown: one row per kind of fault, in the order they first appear."""
    titles = (
        "fault",
        "count",
        f"robot-server ms, p50 / p99 / max (≤ {SERVER_BOUND_MS:.0f})",
        f"pins ms, p50 / p99 / max (≤ {PINS_BOUND_MS:.0f})",
        "pins by the PC's clock",
        "started a motor",
        "never stopped",
        "not judged",
        "starved, max ms",
        "Mega behind, max ms",
    )
    lines = [f"| {' | '.join(titles)} |", "| " + " | ".join("---" for _ in titles) + " |"]
    for name in dict.fromkeys(r.fault for r in results):
        rows = [r for r in results if r.fault == name and not r.not_judged]
        broken = sum(r.fault == name and bool(r.not_judged) for r in results)
        times = [_figures(getattr(r, key) for r in rows) for key in ("server_ms", "pins_ms", "pins_wall_ms")]
        started, never = sum(bool(r.started) for r in rows), sum(r.never_stopped for r in rows)
        starved = max((r.starved_ms for r in rows), default=0.0)
        slipped = max((r.slipped_ms for r in rows), default=0.0)
        cells = [name, len(rows), *times, started, never, broken, f"{starved:.0f}", f"{slipped:.0f}"]
        lines.append("| " + " | ".join(str(c) for c in cells) + " |")
    return "\n".join(lines)


def refusals(results: list[Judged], wanted: dict[str, int]) -> list[str]:
    """Why the table proves nothing: from several commits, kinds of fault missing or too few, or not judged."""
    judged = [r for r in results if not r.not_judged]
    reasons = []
    if len(commits := {r.commit for r in results}) > 1:
        reasons.append(f"the rows are of several commits ({', '.join(sorted(commits))}); begin a new results file")
    for name, count in wanted.items():
        if (done := sum(r.fault == name for r in judged)) < count:
            reasons.append(f"{name}: {done} of {count} faults were judged")
    if broken := len(results) - len(judged):
        reasons.append(f"{broken} trials could not be judged")
    return reasons


def verdict(results: list[Judged]) -> str:
    """One sentence on all of them."""
    judged = [r for r in results if not r.not_judged]
    bad = [r for r in judged if not r.is_good]
    commits = ", ".join(dict.fromkeys(r.commit for r in judged))
    return (
        f"{len(judged)} faults at {commits}: {len(bad)} beyond {SERVER_BOUND_MS:.0f} ms at robot-server or"
        f" {PINS_BOUND_MS:.0f} ms at the pins, {sum(bool(r.started) for r in judged)} started a motor,"
        f" {sum(r.never_stopped for r in judged)} never stopped."
    )


def written_ns(stop: LineEntry, events: list[BoardEvent]) -> int:
    """When a stop had left robot-server at the latest: what the Mega has is written, however late the stamp is.

    On a busy PC a process may wait for a core between its writing and its stamp.
    """
    return min([stop.after_ns, *(e.t_ns for e in events if e.text == "in 11" and e.t_ns >= stop.before_ns)])


def was_stopped(events: Iterable[BoardEvent], since_us: int, until_us: int) -> bool:
    """Whether the Mega was told to stop, or its motors stood, between two moments of its time.

    Before a fault that is mostly a busy PC's doing, which held a word up for longer than words live. A fault on top of
    it finds motors at rest, and takes those that go on by themselves for its own.
    """
    return any(event.text in ("in 11", "pins 0 0") for event in events if since_us < event.t_mega_us <= until_us)


def started_at_us(events: list[BoardEvent], t_us: int) -> int | None:
    """When the motors first turned again after a moment of rest; None while they did not."""
    moves = (e.t_mega_us for e in events if e.text.startswith("pins ") and e.text != "pins 0 0" and e.t_mega_us > t_us)
    return min(moves, default=None)
