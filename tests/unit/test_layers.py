"""Imports point one way (docs/architecture.md)."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
# Package → prefixes it must not import.
FORBIDDEN = {
    "shared": ["robot", "station"],
    "robot": ["station"],
    "station": ["robot"],
    "station/slam": [
        "station.app",
        "station.api",
        "station.web",
        "station.places",
        "station.maps",
        "asyncio",
        "fastapi",
    ],
    "station/places": ["station.app", "station.api", "station.web", "station.slam", "asyncio", "fastapi"],
    "station/maps": ["station.app", "station.api", "station.web", "station.slam", "asyncio", "fastapi"],
    "station/datasets": ["station.app", "station.api", "station.slam", "station.places", "asyncio"],
}


def imported_modules(path: Path) -> set[str]:
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            names.add(node.module)
    return names


@pytest.mark.parametrize("package", FORBIDDEN)
def test_package_imports_only_what_lies_below_it(package: str) -> None:
    for path in (ROOT / package).rglob("*.py"):
        if "node_modules" in path.parts:
            continue
        for module in imported_modules(path):
            for prefix in FORBIDDEN[package]:
                assert module != prefix and not module.startswith(prefix + "."), f"{path} imports {module}"


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
        for path in (ROOT / package).rglob("*.py")
        if any(m == library or m.startswith(library + ".") for m in imported_modules(path))
    }
    assert users == {VENDORS[library]}
