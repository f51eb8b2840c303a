"""The demo waits for what goes on, however slow the computer is, and not for ever."""

from __future__ import annotations

from itertools import count
from pathlib import Path

import pytest

from shared.errors import RobotSystemError
from station.demo.demo import wait_for
from station.demo.processes import Programs


def test_waiting_ends_where_nothing_goes_on_and_not_before(tmp_path: Path) -> None:
    with Programs(tmp_path) as programs:
        with pytest.raises(RobotSystemError, match="SLAM was not ready within 0 s: this computer is too busy"):
            wait_for(programs, "SLAM", lambda: False, 0.0, lambda: "computing")
        asked, told = count(), count()
        wait_for(programs, "SLAM", lambda: next(asked) == 3, 0.1, lambda: next(told))  # 0.6 s in all
