"""When npm installs the page's packages, and which: a stand-in for npm that notes what it is asked for."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from station.web import build_hook

STAND_IN = """#!{bash}
echo "$1 $2 $3" >> calls
case "$1 $2" in
  "ci --omit=dev") rm -rf node_modules; mkdir -p node_modules/swagger-ui-dist ;;
  "ci --include=dev") rm -rf node_modules; mkdir -p node_modules/swagger-ui-dist node_modules/typescript ;;
  "run --silent") mkdir -p dist; exit 0 ;;
esac
touch node_modules/swagger-ui-dist/swagger-ui-bundle.js node_modules/swagger-ui-dist/swagger-ui.css
"""
BUILD, CHECK = "run --silent build", "run --silent check"
TO_BUILD, TO_CHECK = "ci --omit=dev --no-audit", "ci --include=dev --no-audit"


@pytest.fixture
def web(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    npm = tmp_path / "npm"
    npm.write_text(STAND_IN.format(bash=shutil.which("bash")))
    npm.chmod(0o755)
    (tmp_path / "package-lock.json").write_text("{}")
    for name, path in (
        ("WEB", tmp_path),
        ("DIST", tmp_path / "dist"),
        ("STAMP", tmp_path / "dist" / ".sources"),
        ("INSTALLED", tmp_path / "node_modules" / ".installed"),
    ):
        monkeypatch.setattr(build_hook, name, path)
    monkeypatch.setattr(build_hook, "_find_npm", lambda: [str(npm)])
    for variable in ("SENTINEL_NO_PAGE", "SENTINEL_PAGE_TOOLS"):
        monkeypatch.delenv(variable, raising=False)
    return tmp_path


def build_check_and_build(web: Path) -> list[str]:
    """What npm was asked for."""
    assert build_hook.build()
    assert build_hook.check() == ""
    assert build_hook.build(force=True)
    return (web / "calls").read_text().splitlines()


def test_what_checks_the_page_is_installed_only_when_it_is_checked(web: Path) -> None:
    assert build_check_and_build(web) == [TO_BUILD, BUILD, TO_CHECK, CHECK, BUILD]


def test_what_checks_the_page_is_installed_at_once_where_that_is_asked(
    web: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SENTINEL_PAGE_TOOLS", "1")
    assert build_check_and_build(web) == [TO_CHECK, BUILD, CHECK, BUILD]


def test_another_lock_file_installs_all_anew(web: Path) -> None:
    build_hook.build()
    (web / "package-lock.json").write_text("{ }")
    build_hook.build()
    assert (web / "calls").read_text().splitlines() == [TO_BUILD, BUILD, TO_BUILD, BUILD]
