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
    with working("joining") as say:
        say("clustering")
    assert ("clustering" in stream.getvalue()) == stream.isatty()
    assert bool(stream.getvalue()) == stream.isatty()
