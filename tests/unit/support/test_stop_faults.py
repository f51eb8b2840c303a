"""The stop bench's list of faults: what it must hold."""

from __future__ import annotations

from tests.support.stopping import firmware as stop_firmware
from tests.support.stopping.faults import FAULTS

KINDS = (
    "page closed",
    "page frozen",
    "page and network stall together",
    "page dies during a stall",
    "network cut (half-open)",
    "station SIGKILL",
    "station SIGSTOP",
    "robot-server's loop blocked",
    "robot-server SIGSTOP",
    "robot-server SIGKILL",
    "serial unplugged",
    "camera hung",
    "flood of frames",
    "two drivers",
    "wall clock jumped",
)


def test_every_kind_of_fault_is_there_and_a_thousand_in_all() -> None:
    names = [fault.name for fault in FAULTS]
    assert len(set(names)) == len(names)
    assert [kind for kind in KINDS if not any(name.startswith(kind) for name in names)] == []
    assert sum(fault.count for fault in FAULTS) + sum(stop_firmware.FAULTS.values()) >= 1000


def test_only_what_takes_robot_server_or_its_line_away_is_left_to_the_firmware_alone() -> None:
    below = {fault.name for fault in FAULTS if not fault.is_above_server}
    assert below == {
        "robot-server SIGSTOP",
        "robot-server SIGKILL",
        "serial unplugged",
        "camera hung, holds the interpreter",
    }
