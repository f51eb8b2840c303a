"""`scripts/open3d-need.sh` without a network and without root: it says what is skipped, and `make test` goes on."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.support.paths import ROOT

APT_LINE = "Open3D tests are skipped: run: sudo apt-get install libegl1 libgl1 libusb-1.0-0 libx11-6"
# Finds the library where a file "installed" lies, loads it where "loads" does; pip works where "network" does.
PYTHON = """#!{bash}
case "$*" in
  *find_spec*) [ -e installed ] ;;
  *"-m pip install"*) echo "$*" >> pip; [ -e network ] && : > installed ;;
  *"import open3d"*) [ -e installed ] && [ -e loads ] ;;
  *tomllib*) echo open3d ;;
esac
"""


class Machine:
    """A folder with the scripts and a stand-in for Python, and a user who is not root and has no Debian package."""

    def __init__(self, root: Path) -> None:
        self.root, self.bin = root, root / "bin"
        (root / "scripts").mkdir()
        (root / ".venv" / "bin").mkdir(parents=True)
        self.bin.mkdir()
        for name in ("open3d-need.sh", "apt-need.sh"):
            shutil.copy(ROOT / "scripts" / name, root / "scripts")
        for tool in ("bash", "dirname", "env", "grep"):
            found = shutil.which(tool)
            assert found is not None
            (self.bin / tool).symlink_to(found)
        self.program(self.bin / "id", "#!{bash}\necho 1000\n")
        self.program(self.bin / "dpkg-query", "#!{bash}\nexit 1\n")
        self.program(root / ".venv" / "bin" / "python", PYTHON)

    def program(self, path: Path, text: str) -> None:
        path.write_text(text.replace("{bash}", str(shutil.which("bash"))))
        path.chmod(0o755)

    def need(self) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [self.bin / "bash", self.root / "scripts" / "open3d-need.sh"],
            env={"PATH": str(self.bin), "HOME": os.environ.get("HOME", "/")},
            cwd=self.root, capture_output=True, text=True, timeout=60, check=False,
        )  # fmt: skip


@pytest.fixture
def machine(tmp_path: Path) -> Machine:
    return Machine(tmp_path)


def test_what_works_is_left_alone(machine: Machine) -> None:
    for name in ("installed", "loads"):
        (machine.root / name).touch()
    done = machine.need()
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    assert not (machine.root / "pip").exists()


def test_what_is_missing_is_installed_and_said(machine: Machine) -> None:
    for name in ("network", "loads"):
        (machine.root / name).touch()
    done = machine.need()
    assert done.returncode == 0 and done.stderr == ""
    assert "installing it into .venv" in done.stdout
    assert "-c constraints.txt open3d" in (machine.root / "pip").read_text()


def test_without_a_network_the_tests_are_skipped_by_name(machine: Machine) -> None:
    done = machine.need()
    assert done.returncode == 0
    assert done.stderr.splitlines() == ["Open3D tests are skipped: pip could not install it"]


def test_without_root_the_apt_line_is_said(machine: Machine) -> None:
    (machine.root / "installed").touch()
    done = machine.need()
    assert done.returncode == 0
    assert done.stderr.splitlines() == [APT_LINE]
