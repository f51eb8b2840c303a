"""The Mega's port has one owner: a second robot-server and the flashing step are refused with a sentence."""

from __future__ import annotations

import os
import pty
import shutil
import subprocess
import tty
from collections.abc import Iterator

import pytest

from robot.config import PiConfig
from robot.devices.pi import adapter
from robot.devices.pi.serial_line import PySerialLine
from shared.errors import DeviceUnavailable
from tests.support.emulator import board
from tests.support.paths import ROOT


@pytest.fixture
def port() -> Iterator[str]:
    master, slave = pty.openpty()
    tty.setraw(slave)
    yield os.ttyname(slave)
    os.close(master)
    os.close(slave)


def test_a_second_robot_server_does_not_get_the_port(port: str) -> None:
    first = PySerialLine(port)
    with pytest.raises(DeviceUnavailable, match=r"in use by another program.*systemctl stop sentinel-robot"):
        adapter.open_pi(PiConfig(serial_port=port, camera=False))
    first.close()
    PySerialLine(port).close()  # free again


@pytest.mark.skipif(board.missing_reason() is not None, reason=board.missing_reason() or "")
@pytest.mark.skipif(shutil.which("flock") is None, reason="needs flock (util-linux)")
def test_the_mega_is_not_flashed_under_a_running_robot_server(port: str) -> None:
    board.build()

    def upload() -> subprocess.CompletedProcess[str]:
        command = ["make", "-C", str(ROOT / "firmware"), "upload", f"PORT={port}", "AVRDUDE=echo flashed with"]
        return subprocess.run(command, capture_output=True, text=True, timeout=120)

    line = PySerialLine(port)
    refused = upload()
    assert refused.returncode != 0 and "flashed" not in refused.stdout
    assert "in use by another program" in refused.stderr and "systemctl stop sentinel-robot" in refused.stderr
    line.close()
    done = upload()
    assert done.returncode == 0 and f"flashed with -p atmega2560 -c wiring -P {port}" in done.stdout


def test_an_upload_to_a_port_that_is_not_there_says_so() -> None:
    if (reason := board.missing_reason()) is not None:
        pytest.skip(reason)
    board.build()
    command = ["make", "-C", str(ROOT / "firmware"), "upload", "PORT=/dev/no-such-mega"]
    run = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert run.returncode != 0 and "/dev/no-such-mega does not exist" in run.stderr
