"""Which recordings go when there are too many."""

from __future__ import annotations

from station.library.recordings import FinishedRecording, to_remove


def test_the_oldest_recordings_go_first() -> None:
    finished = [FinishedRecording(str(day), day * 86_400.0, 10) for day in range(5)]
    now_s = 5 * 86_400.0
    assert to_remove(finished, 0, 0, now_s) == []
    assert [r.navigation_id for r in to_remove(finished, 25, 0, now_s)] == ["0", "1", "2"]
    assert [r.navigation_id for r in to_remove(finished, 0, 3.5 * 86_400, now_s)] == ["0", "1"]
    assert [r.navigation_id for r in to_remove(finished, 45, 4.5 * 86_400, now_s)] == ["0"]
