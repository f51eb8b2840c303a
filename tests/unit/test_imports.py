"""What import-linter (pyproject.toml, `make lint`) cannot say of imports: parts' libraries, tests and benchmarks."""

import ast
import functools
from pathlib import Path

import pytest

from tests.support.paths import ROOT

VENDORS = {  # a part's library → the one file of robot-server that may import it
    "picamera2": "robot/devices/pi/camera.py",
    "simplejpeg": "robot/devices/pi/camera.py",
    "gpiozero": "robot/devices/pi/gpio_pins.py",
    "smbus2": "robot/devices/pi/ina219.py",
    "serial": "robot/devices/pi/serial_line.py",
}


@functools.cache
def imported_modules(source: str) -> set[str]:
    """Full names of all modules imported, and of what is imported from them: it may be a module itself."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0 and node.module, "relative imports hide which layer they reach"
            names.update(f"{node.module}.{alias.name}" for alias in node.names)
    return names


def importers(prefix: str, *packages: str) -> set[str]:
    """The files below these folders that import a package."""
    files = [
        path for package in packages for path in (ROOT / package).rglob("*.py") if "node_modules" not in path.parts
    ]
    assert files, f"{packages} hold no module: were they renamed?"
    return {
        path.relative_to(ROOT).as_posix()
        for path in files
        if any(name == prefix or name.startswith(prefix + ".") for name in imported_modules(path.read_text()))
    }


@pytest.mark.parametrize("library", VENDORS)
def test_a_parts_library_is_imported_in_its_adapter_only(library: str) -> None:
    assert importers(library, "robot", "station", "shared") == {VENDORS[library]}


def test_tests_import_no_benchmark() -> None:
    assert importers("benchmarks", "tests") == set()


def test_benchmarks_and_scripts_use_what_supports_tests_and_no_test() -> None:
    for path in map(Path, importers("tests", "benchmarks", "scripts")):
        used = {name for name in imported_modules((ROOT / path).read_text()) if name.startswith("tests")}
        assert all(name.startswith("tests.support.") for name in used), f"{path} imports {used}"


@pytest.mark.parametrize(
    "source", ["import station.api", "from station import api", "from station.api import views", "import station.api.x"]
)
def test_every_way_to_import_a_package_is_seen(source: str) -> None:
    assert any(name.startswith("station.api") for name in imported_modules(source))
