"""Commands that our sentences advise, whole: what a person copies from them works where that person is."""

from __future__ import annotations

import re
import shlex
import sys
from collections.abc import Mapping
from pathlib import Path

PROJECT = Path(__file__).resolve().parents[1]


def install(*extras: str) -> str:
    """The command that adds the libraries of these extras (pyproject.toml) to the Python that runs."""
    names = f"[{','.join(extras)}]"
    if (PROJECT / "pyproject.toml").is_file():
        return f"{python()} -m pip install -e {shlex.quote(f'{PROJECT}{names}')}"
    # We are a copy, as on the robot.
    return f"{python()} -m pip install {shlex.quote(f'.{names}')} in Sentinel's folder"


def python() -> str:
    """The Python that runs, as a shell takes it."""
    return shlex.quote(sys.executable)


def option(name: str, value: Path | str | None) -> str:
    """An option with its value, to be written after a command; nothing where there is no value."""
    return "" if value is None else f" {name} {shlex.quote(str(value))}"


def complete(sentence: str, program: str, options: Mapping[str, Path | str | None]) -> str:
    """A sentence whose commands in backticks name the program, and the options with which they reach the same data.

    What knows neither writes `access init`, or `station map repair`. Files "written by" a command need no options.
    """

    def whole(advised: re.Match[str]) -> str:
        missing = (option(name, value) for name, value in options.items() if f" {name} " not in advised[1])
        return f"`{program} {advised[1]}{''.join(missing)}`"

    return re.sub(rf"(?<!written by )`(?:{program} )?((?:access|map|robots)\b[^`]*)`", whole, sentence)
