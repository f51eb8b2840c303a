"""`--help` answers at once: what takes seconds to import is imported by the command that needs it."""

from __future__ import annotations

import importlib
import pkgutil
import subprocess
import sys

import pytest
import typer
from typer.main import get_group

import station.commands
from station.main import COMMANDS, load_command

HEAVY = ("numpy", "cv2", "scipy", "sklearn", "pycolmap", "open3d", "fastapi", "sqlalchemy", "matplotlib", "asyncio")
LOOK = """
import contextlib, io, sys
from {module} import main
sys.argv = ["program", *{arguments}]
with contextlib.redirect_stdout(io.StringIO()) as text, contextlib.suppress(SystemExit):
    main()
assert "--help" in text.getvalue(), text.getvalue()
print(*sorted({heavy} & sys.modules.keys()))
"""


def heavy_modules(module: str, *arguments: str) -> list[str]:
    """What of the heavy libraries a program has imported at its end."""
    look = LOOK.format(module=module, arguments=list(arguments), heavy=set(HEAVY))
    return subprocess.run([sys.executable, "-c", look], capture_output=True, text=True, check=True).stdout.split()


@pytest.mark.parametrize("module", ["station.main", "robot.main"])
def test_help_imports_no_heavy_library(module: str) -> None:
    assert heavy_modules(module, "--help") == []


def test_a_light_command_does_not_wait_for_the_libraries_of_another() -> None:
    assert not {"cv2", "scipy", "sklearn", "pycolmap"} & set(heavy_modules("station.main", "doctor", "--help"))


def test_every_command_is_listed() -> None:
    commands = typer.Typer()
    for found in pkgutil.iter_modules(station.commands.__path__):
        module = importlib.import_module(f"station.commands.{found.name}")
        if hasattr(module, "register") and found.name != "map_store":  # that registers commands of `station map`
            module.register(commands)
    assert get_group(commands).commands.keys() == COMMANDS.keys()


@pytest.mark.parametrize("name", COMMANDS)
def test_what_is_listed_can_be_called(name: str) -> None:
    command = load_command(name)
    assert command.name == name and command.help


@pytest.mark.parametrize("name", COMMANDS)
def test_what_is_listed_is_how_the_commands_own_help_begins(name: str) -> None:
    _, listed = COMMANDS[name]
    own = (load_command(name).help or "").partition("\n")[0]
    start = listed.removesuffix(".")
    assert own.startswith(start) and own[len(start) :][:1] in (".", ";", "")
