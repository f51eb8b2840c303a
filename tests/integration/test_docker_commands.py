"""Both images' default commands, run here as they are run there: there is no Docker where tests run."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
import tomllib
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

ROOT = Path(__file__).parents[2]
DOCKER = ROOT / "docker"


def default_command(name: str) -> tuple[str, list[str]]:
    """Program and arguments of `docker run IMAGE`."""
    text = (DOCKER / name).read_text()
    entrypoint, command = (re.search(rf"^{word} (\[.*\])$", text, re.MULTILINE) for word in ("ENTRYPOINT", "CMD"))
    assert entrypoint and command
    (program,) = json.loads(entrypoint[1])
    return program, json.loads(command[1])


@contextmanager
def started(program: str, arguments: list[str], folder: Path) -> Iterator[str]:
    """The first line that a program says; it must end well when it is asked to."""
    scripts = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["scripts"]
    module = scripts[program].partition(":")[0]
    process = subprocess.Popen(
        [sys.executable, "-m", module, *arguments],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    try:
        yield process.stdout.readline()
    finally:
        process.send_signal(signal.SIGTERM)
        process.communicate(timeout=60)
    assert process.returncode == 0


def test_both_images_serve_with_their_default_commands_and_find_each_other(tmp_path: Path) -> None:
    # Only the ports are others than in the images: 7400 and 8080 may be taken on this machine.
    robot, simulated = default_command("robot.Dockerfile")
    station, serve = default_command("station.Dockerfile")
    with started(robot, [*simulated, "--port", "0"], tmp_path) as said:
        address = re.search(r"127\.0\.0\.1:\d+", said)
        assert address, said
        with started(station, [*serve, "--robot", address[0], "--port", "0"], tmp_path) as said:
            page = re.search(r"http://127\.0\.0\.1:\d+", said)
            assert page, said
            while True:
                with urllib.request.urlopen(f"{page[0]}/robot", timeout=60) as answer:
                    if json.load(answer)["connected"]:
                        break
                time.sleep(0.1)
    assert (tmp_path / "data").is_dir()


def test_what_the_station_records_by_default_is_in_its_volume() -> None:
    text = (DOCKER / "station.Dockerfile").read_text()
    folder = re.findall(r"^WORKDIR (\S+)$", text, re.MULTILINE)[-1]
    _, arguments = default_command("station.Dockerfile")
    assert f"VOLUME {folder}/{arguments[arguments.index('--data') + 1]}\n" in text
