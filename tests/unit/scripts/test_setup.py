"""`scripts/setup.sh` on machines with other Pythons than this one: stand-ins that only answer what it asks."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.support.paths import ROOT

SCRIPT = ROOT / "scripts" / "setup.sh"
TOOLS = ("bash", "dirname", "rm", "touch", "mkdir", "cat", "chmod")
# Says of itself what FITS and HAS_VENV tell; without venv it leaves half an environment behind, as Debian's does.
STAND_IN = """#!{bash}
case "$*" in
  *"not (3, 11)"*) exit {misfit} ;;
  *"import ensurepip"*) exit {lacks_venv} ;;
  *"-venv"*) echo python3.{minor}-venv ;;
  "-m venv "*)
    mkdir -p "$3/bin"
    printf '#!{bash}\\necho "{name} $*" >> calls\\n' > "$3/bin/python"
    printf 'echo "$SENTINEL_PAGE_TOOLS" > page_tools\\nexit {lacks_venv}\\n' >> "$3/bin/python"
    chmod +x "$3/bin/python"
    exit {lacks_venv} ;;
esac
"""


class Machine:
    """A folder with the script, and a PATH that holds nothing but a few tools and the stand-ins."""

    def __init__(self, root: Path) -> None:
        self.root, self.bin = root, root / "bin"
        self.bin.mkdir()
        (root / "scripts").mkdir()
        shutil.copy(SCRIPT, root / "scripts")
        for tool in TOOLS:
            found = shutil.which(tool)
            assert found is not None
            (self.bin / tool).symlink_to(found)
        self._command("id", "echo 1000")  # not root: no Debian package may be added

    def _command(self, name: str, body: str) -> None:
        (self.bin / name).write_text(f"#!{shutil.which('bash')}\n{body}\n")
        (self.bin / name).chmod(0o755)

    def add_python(self, name: str, minor: int, *, fits: bool = True, has_venv: bool = True) -> None:
        text = STAND_IN.format(
            bash=shutil.which("bash"), name=name, minor=minor, misfit=int(not fits), lacks_venv=int(not has_venv)
        )
        (self.bin / name).write_text(text)
        (self.bin / name).chmod(0o755)

    def add_root(self, makes: str) -> None:
        """Root, and an apt-get that notes what it is asked for and gives the Python of that name its venv."""
        self._command("id", "echo 0")
        self._command("apt-get", f'echo "$*" >> apt\ncat "bin/{makes}.whole" > "bin/{makes}"')

    def setup(self, *kind: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [self.bin / "bash", self.root / "scripts" / "setup.sh", *kind],
            env={"PATH": str(self.bin), "HOME": os.environ.get("HOME", "/")},
            cwd=self.root, capture_output=True, text=True, timeout=60, check=False,
        )  # fmt: skip


@pytest.fixture
def machine(tmp_path: Path) -> Machine:
    return Machine(tmp_path)


def test_without_python_one_sentence_says_so(machine: Machine) -> None:
    machine.add_python("python3", 9, fits=False)
    result = machine.setup()
    assert result.returncode != 0
    assert result.stderr.splitlines() == [
        "setup: needs Python 3.11, 3.12 or 3.13; on Debian: apt-get install python3 python3-venv"
    ]


def test_without_venv_the_package_of_that_python_is_named_and_nothing_is_left(machine: Machine) -> None:
    machine.add_python("python3.12", 12, has_venv=False)
    result = machine.setup()
    assert result.returncode != 0 and not (machine.root / ".venv").exists()
    assert result.stderr.splitlines() == [
        "setup: python3.12 cannot make an environment; run: sudo apt-get install python3.12-venv"
    ]


def test_a_python_that_can_make_environments_is_preferred(machine: Machine) -> None:
    machine.add_python("python3.12", 12, has_venv=False)
    machine.add_python("python3", 11)
    assert machine.setup().returncode == 0
    assert "python3 -m pip install" in (machine.root / "calls").read_text()


@pytest.mark.parametrize(("kind", "tools"), [("run", ""), ("dev", "1")])
def test_what_checks_the_page_is_installed_with_the_rest_for_development(
    machine: Machine, kind: str, tools: str
) -> None:
    machine.add_python("python3", 11)
    assert machine.setup(kind).returncode == 0
    assert (machine.root / "page_tools").read_text() == f"{tools}\n"
    assert (machine.root / ".venv" / f".{kind}").exists()


def test_an_environment_alone_installs_nothing_and_is_no_reason_to_leave_that_out_later(machine: Machine) -> None:
    machine.add_python("python3", 11)
    assert machine.setup("env").returncode == 0
    assert "pip install" not in (machine.root / "calls").read_text()
    assert [path.name for path in (machine.root / ".venv").iterdir()] == ["bin"]


def test_half_an_environment_is_made_anew(machine: Machine) -> None:
    (machine.root / ".venv" / "bin").mkdir(parents=True)
    broken = machine.root / ".venv" / "bin" / "python"
    broken.write_text(f"#!{shutil.which('bash')}\nexit 1\n")
    broken.chmod(0o755)
    machine.add_python("python3", 11)
    assert machine.setup().returncode == 0
    assert (machine.root / ".venv" / ".run").exists()


def test_root_gets_the_package_of_the_chosen_python(machine: Machine) -> None:
    machine.add_python("python3.12", 12)
    (machine.bin / "python3.12").rename(machine.bin / "python3.12.whole")
    machine.add_python("python3.12", 12, has_venv=False)
    machine.add_root("python3.12")
    result = machine.setup()
    assert result.returncode == 0, result.stderr
    assert "install -y -qq python3.12-venv" in (machine.root / "apt").read_text()
