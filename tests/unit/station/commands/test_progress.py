"""Long work shows a moving bar to people, and nothing to files and pipes."""

import io
import sys

import pytest

from station.commands.progress import working


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize("stream", [Terminal(), io.StringIO()], ids=["terminal", "file"])
def test_a_terminal_sees_what_is_being_done(stream: io.StringIO, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr(sys, "stderr", stream)
    with working("joining") as bar:
        bar.step("clustering")
    assert ("clustering" in stream.getvalue()) == stream.isatty()
    assert bool(stream.getvalue()) == stream.isatty()


def test_what_is_counted_fills_the_bar_and_what_is_not_moves_it(monkeypatch: pytest.MonkeyPatch) -> None:
    stream = Terminal()
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "120")
    monkeypatch.setattr(sys, "stderr", stream)

    def shown() -> str:
        """What stands there now."""
        stream.seek(0)
        stream.truncate()
        bar._progress.refresh()
        return stream.getvalue()

    with working("opening") as bar:
        bar.step("reading frames", 30)
        bar.advance()
        bar.advance("keyframe")
        assert "keyframe" in shown() and "2/30 " in shown()
        bar.step("making the map")
        assert "making the map" in shown() and "/" not in shown()
        bar.reach(1.4, 20.0)
        assert "1/20 s" in shown()
