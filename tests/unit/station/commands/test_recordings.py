"""`station recordings …` over what is no recording."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from shared.errors import DataError
from station.commands.recordings import recover


def test_a_folder_and_a_pipe_are_called_what_they_are(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for name, what in (("", "is a folder"), ("pipe", "is a pipe"), ("none", "is not there"), ("a" * 300, "too long")):
        with pytest.raises(DataError, match=what):
            recover(tmp_path / name)
