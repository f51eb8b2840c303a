"""Imports point one way (docs/architecture.md)."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
# Package → prefixes it must not import.
ABOVE = ["station.app", "station.api", "station.api.serving", "station.commands", "station.demo", "station.experiments"]
THINKING = [*ABOVE, "station.evaluation", "asyncio", "fastapi"]  # truth judges: no estimator may even see it
FORBIDDEN = {
    "shared": ["robot", "station"],
    "robot": ["station"],
    "station": ["robot"],
    "station/slam": [*THINKING, "station.places", "station.maps"],
    "station/places": [*THINKING, "station.slam"],
    "station/maps": [*THINKING, "station.slam"],
    "station/datasets": [*THINKING, "station.slam", "station.places", "station.maps"],
    "station/evaluation": [*ABOVE, "asyncio", "fastapi"],
    "station/experiments": [
        "station.app",
        "station.api",
        "station.api.serving",
        "station.commands",
        "asyncio",
        "fastapi",
    ],
    "station/app.py": ["station.api", "station.api.serving", "station.commands", "station.demo", "fastapi"],
    "station/api": ["station.api.serving", "station.commands", "station.demo", "station.experiments"],
}


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


def sources(package: str) -> list[Path]:
    path = ROOT / package
    found = [path] if path.is_file() else [p for p in path.rglob("*.py") if "node_modules" not in p.parts]
    assert found, f"{package} holds no module: was it renamed?"
    return found


def is_within(module: str, prefix: str) -> bool:
    return module == prefix or module.startswith(prefix + ".")


@pytest.mark.parametrize("package", FORBIDDEN)
def test_package_imports_only_what_lies_below_it(package: str) -> None:
    for path in sources(package):
        for module in imported_modules(path.read_text()):
            for prefix in FORBIDDEN[package]:
                assert not is_within(module, prefix), f"{path} imports {module}"


VENDORS = {  # a part's library → the one file of robot-server that may import it
    "picamera2": "robot/devices/pi/camera.py",
    "simplejpeg": "robot/devices/pi/camera.py",
    "gpiozero": "robot/devices/pi/gpio_pins.py",
    "smbus2": "robot/devices/pi/ina219.py",
    "serial": "robot/devices/pi/serial_line.py",
}


@pytest.mark.parametrize("library", VENDORS)
def test_a_parts_library_is_imported_in_its_adapter_only(library: str) -> None:
    users = {
        str(path.relative_to(ROOT))
        for package in ("robot", "station", "shared")
        for path in sources(package)
        if any(is_within(module, library) for module in imported_modules(path.read_text()))
    }
    assert users == {VENDORS[library]}


@pytest.mark.parametrize("prefix", sorted({p for prefixes in FORBIDDEN.values() for p in prefixes if "." in p}))
def test_what_is_forbidden_exists(prefix: str) -> None:
    path = ROOT / prefix.replace(".", "/")
    assert path.is_dir() or path.with_suffix(".py").is_file(), f"{prefix} was renamed: no rule guards it any more"


@pytest.mark.parametrize(
    "source",
    [
        "import station.api",
        "from station import api",
        "from station.api import views",
        "from station.api.views import x",
    ],
)
def test_every_way_to_import_a_package_is_seen(source: str) -> None:
    assert any(is_within(module, "station.api") for module in imported_modules(source))
