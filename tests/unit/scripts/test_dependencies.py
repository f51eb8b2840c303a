"""What is declared as a dependency is used: every library is a download, a licence and a risk."""

from __future__ import annotations

import ast
import re
import tomllib
from importlib.metadata import packages_distributions

import pytest

from tests.support.paths import ROOT

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
EXTRAS = ("robot", "simulation", "station")  # the others: only tools, and a driver that SQLAlchemy imports


@pytest.fixture(scope="module")
def imported() -> set[str]:
    """First names of all modules that our packages import."""
    names: set[str] = set()
    for package in ("shared", "robot", "station"):
        for path in (ROOT / package).rglob("*.py"):
            if "node_modules" in path.parts:
                continue
            for node in ast.walk(ast.parse(path.read_text())):
                if isinstance(node, ast.Import):
                    names.update(alias.name.partition(".")[0] for alias in node.names)
                elif isinstance(node, ast.ImportFrom) and node.module:
                    names.add(node.module.partition(".")[0])
    return names


def canonical(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


@pytest.mark.parametrize("extra", [None, *EXTRAS])
def test_every_dependency_is_imported(extra: str | None, imported: set[str]) -> None:
    requirements = PROJECT["dependencies"] if extra is None else PROJECT["optional-dependencies"][extra]
    modules: dict[str, set[str]] = {}
    for module, distributions in packages_distributions().items():
        for distribution in distributions:
            modules.setdefault(canonical(distribution), set()).add(module)
    wanted = {canonical(re.split(r"[^\w.-]", requirement)[0]) for requirement in requirements}
    installed = wanted & modules.keys()  # some are for other platforms
    assert len(installed) > 1
    assert not {name for name in installed if not modules[name] & imported}
