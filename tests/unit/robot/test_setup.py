"""What robot/install.sh and its files promise, as far as a PC can tell."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from robot.config import load_config
from robot.devices.pi.gpio_pins import ENDING
from tests.support.debian import DEBIAN_NUMPY
from tests.support.paths import ROOT

SETUP = ROOT / "robot" / "setup"
UNIT = SETUP / "sentinel-robot.service"
KILL_SIGNALS = {"KillSignal": "SIGTERM", "WatchdogSignal": "SIGABRT"}  # and what they are where the unit says nothing


@pytest.mark.parametrize("numpy", DEBIAN_NUMPY.values())
def test_the_robot_is_content_with_the_numpy_of_pi_os(numpy: str) -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    wanted = [*project["dependencies"], *project["optional-dependencies"]["robot"]]
    (requirement,) = [r for r in map(Requirement, wanted) if r.name == "numpy"]
    assert requirement.specifier.contains(numpy)


def test_the_settings_it_installs_are_valid() -> None:
    assert load_config(SETUP / "robot.toml", {}).pi.serial_port == "/dev/sentinel-mega"


def test_the_unit_waits_for_ready_and_restarts_for_ever_what_falls_silent() -> None:
    lines = set(UNIT.read_text().splitlines())
    assert {"Type=notify", "WatchdogSec=5", "Restart=always", "StartLimitIntervalSec=0"} <= lines


def test_all_that_the_unit_sends_to_the_motor_pins_process_lets_it_stop_the_motors() -> None:
    """KillMode "mixed" sends it SIGKILL as soon as robot-server has died; systemd's watchdog sends SIGABRT."""
    settings = dict(line.split("=", 1) for line in UNIT.read_text().splitlines() if "=" in line and line[0] != "#")
    assert settings.get("KillMode", "control-group") == "control-group"
    sent = {signal.Signals[settings.get(key, default)] for key, default in KILL_SIGNALS.items()}
    assert sent <= set(ENDING)


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="needs systemd-analyze")
def test_systemd_understands_the_unit(tmp_path: Path) -> None:
    program = "/opt/sentinel/venv/bin/robot-server"
    here = tmp_path / UNIT.name
    here.write_text(UNIT.read_text().replace(program, "/bin/true").replace("User=sentinel\n", ""))
    run = subprocess.run(["systemd-analyze", "verify", "--man=no", str(here)], capture_output=True, text=True)
    ours = [line for line in run.stderr.splitlines() if UNIT.name in line]
    assert not ours, ours
    broken = tmp_path / "broken" / UNIT.name
    broken.parent.mkdir()
    broken.write_text(here.read_text().replace("WatchdogSec=5", "WatchdogSek=5"))
    run = subprocess.run(["systemd-analyze", "verify", "--man=no", str(broken)], capture_output=True, text=True)
    assert "WatchdogSek" in run.stderr  # it does look


def test_root_owns_the_program_that_root_runs_and_the_service_only_its_state() -> None:
    """The next update runs pip from the venv as root: who may write there is root."""
    script = (ROOT / "robot" / "install.sh").read_text()
    (made,) = re.findall(r"useradd (.+)$", script, re.MULTILINE)
    assert '--home-dir "$state"' in made and "--create-home" not in made and "nologin" in made
    given = re.findall(r"^.*(?:chown|-o \"\$user\").*$", script, re.MULTILINE)
    assert given == ['install -d -m 700 -o "$user" -g "$user" "$state"']
    assert 'install -d -m 755 -o root -g root "$target"' in script
    values = dict(re.findall(r"^(target|state)=(\S+)", script, re.MULTILINE))
    assert not values["state"].startswith(values["target"])


@pytest.mark.skipif(os.geteuid() != 0, reason="needs root, to own files as another user")
def test_a_program_that_an_earlier_release_gave_to_the_service_is_set_aside(tmp_path: Path) -> None:
    """What its user may have changed is never run by root again. systemctl and usermod are out of a test's reach."""
    script = (ROOT / "robot" / "install.sh").read_text()
    start = script.index('if [ -d "$target" ]')
    moving = script[start : script.index("\nfi\n", start) + 4]
    target = tmp_path / "sentinel"
    (target / "venv").mkdir(parents=True)
    os.chown(target, 65534, 65534)
    quiet = "systemctl() { :; }; usermod() { echo usermod $*; }\n"
    names = f"target={target} state=/var/lib/sentinel user=sentinel\n"
    for _ in range(2):  # the second time there is nothing to do
        run = subprocess.run(["bash", "-euc", quiet + names + moving], capture_output=True, text=True)
        assert run.returncode == 0, run.stderr
        if target.exists():
            assert not run.stdout
        target.mkdir(exist_ok=True)
    (aside,) = tmp_path.glob("sentinel.before-*")
    assert (aside / "venv").is_dir() and target.stat().st_uid == 0


def test_the_script_is_valid_bash_and_names_files_that_exist() -> None:
    script = ROOT / "robot" / "install.sh"
    assert subprocess.run(["bash", "-n", str(script)]).returncode == 0
    named = [word.split("/", 1)[1].strip('"') for word in script.read_text().split() if word.startswith('"$here/robot')]
    assert len(named) == 4
    for name in named:
        assert (ROOT / name).is_file(), name
