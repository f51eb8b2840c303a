"""A simulated robot may run for days."""

from __future__ import annotations

import errno
import os

import numpy as np
import pytest

from robot.devices.simulated.truth_log import TruthLog
from tests.support.memory import grown_bytes


def test_true_poses_of_hours_take_no_memory() -> None:
    log = TruthLog(1_000_000)

    def live() -> None:
        for t_ns in range(5000):
            log.append(t_ns, np.eye(4))

    assert grown_bytes(live, live) < 10_000
    assert len(log.read()) == 10_000


def poses(count: int) -> list[tuple[int, np.ndarray]]:
    return [(n, n * np.eye(4)) for n in range(count)]


@pytest.mark.parametrize("count", [0, 3, 5, 6, 13])
def test_the_newest_true_poses_are_read_back_in_order(count: int) -> None:
    log = TruthLog(5)
    for t_ns, T in poses(count):
        log.append(t_ns, T)
    kept = log.read()
    assert [t for t, _ in kept] == list(range(max(0, count - 5), count))
    assert all((t * np.eye(4) == T).all() for t, T in kept)


def test_on_a_full_disk_the_log_ends_and_the_robot_moves_on(monkeypatch: pytest.MonkeyPatch) -> None:
    log = TruthLog(5)
    log.append(0, np.eye(4))

    def fail(*_: object) -> int:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "pwrite", fail)
    log.append(1, np.eye(4))
    monkeypatch.undo()
    log.append(2, np.eye(4))
    assert [t for t, _ in log.read()] == [0]
