"""Which recordings go when there are too many: the oldest of finished navigations. What SLAM made of them stays."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class KeptRecording:
    """A recording of a finished navigation."""

    navigation_id: str
    started_wall_s: float  # seconds since 1970
    bytes: int


def to_remove(
    recordings: Iterable[KeptRecording], max_bytes: int, max_age_s: float, now_wall_s: float
) -> list[KeptRecording]:
    """The ones to remove, oldest first. A limit of 0 is none."""
    newest_first = sorted(recordings, key=lambda r: (-r.started_wall_s, r.navigation_id))
    removed = []
    total = 0
    for recording in newest_first:
        total += recording.bytes
        is_old = max_age_s > 0 and now_wall_s - recording.started_wall_s > max_age_s
        if is_old or (max_bytes > 0 and total > max_bytes):
            removed.append(recording)
    return removed[::-1]
