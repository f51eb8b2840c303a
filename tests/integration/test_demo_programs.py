"""The demo's child programs end with it, also when a person presses Ctrl-C twice."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from shared.errors import ConfigError, RobotSystemError
from station.demo import demo
from station.demo.demo import Demo, DemoOptions, finish, wait_for_slam
from station.demo.folder import alone_in, fresh_folder, require_free
from station.demo.processes import Programs
from station.demo.simulator_client import SimulatorClient
from station.demo.station_client import StationClient
from tests.support.station import running_station
from tests.support.station_at_work import keep_navigation

SCRIPT = """
import signal, sys
from pathlib import Path
from station.demo.processes import Programs
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background job starts with it ignored
try:
    with Programs(Path(sys.argv[1])) as programs:
        programs.start("server", "http.server", "--bind", "127.0.0.1", "0")
        print(programs.pid("server"), flush=True)
        signal.pause()
except KeyboardInterrupt:
    pass
"""


def is_alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def test_programs_end_also_at_a_second_interrupt(tmp_path: Path) -> None:
    command = [sys.executable, "-c", SCRIPT, str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as demo:
        try:
            assert demo.stdout is not None
            server = int(demo.stdout.readline())
            assert is_alive(server)
            demo.send_signal(signal.SIGINT)
            demo.send_signal(signal.SIGINT)
            demo.wait(30)
        finally:
            demo.kill()
    assert not is_alive(server)


def test_a_program_that_ends_early_is_named_with_its_last_words(tmp_path: Path) -> None:
    with Programs(tmp_path) as programs:
        programs.start("server", "http.server", "--bind", "127.0.0.1", "no-port")
        with pytest.raises(RobotSystemError, match=r"server ended with code 2: .*invalid"):
            programs.wait("server", 30)


def test_a_program_that_may_end_must_not_fail(tmp_path: Path) -> None:
    with Programs(tmp_path) as programs:
        programs.start("driver", "this_module_does_not_exist")
        os.waitid(os.P_PID, programs.pid("driver"), os.WEXITED | os.WNOWAIT)
        with pytest.raises(RobotSystemError, match=r"driver ended with code 1"):
            programs.check(may_end="driver")


def test_a_second_demo_keeps_the_one_before_and_forgets_its_verdict(tmp_path: Path) -> None:
    first = fresh_folder(tmp_path)
    (first / "maps").mkdir()
    (tmp_path / "results.json").write_text('{"passed": true}')
    assert fresh_folder(tmp_path) == first
    assert (tmp_path / "previous" / "maps").is_dir() and not (first / "maps").exists()
    assert not (tmp_path / "results.json").exists()


@pytest.mark.parametrize("name", ["data", "previous"])
def test_a_folder_of_somebody_else_is_left_alone(tmp_path: Path, name: str) -> None:
    fresh_folder(tmp_path)
    for folder in ("data", "previous"):
        (tmp_path / folder).mkdir(exist_ok=True)
        (tmp_path / folder / ".sentinel-demo").touch()
    (tmp_path / name / ".sentinel-demo").unlink()
    (tmp_path / name / "letters.txt").write_text("mine")
    with pytest.raises(ConfigError, match=name):
        fresh_folder(tmp_path)
    assert (tmp_path / name / "letters.txt").read_text() == "mine"


def test_an_out_that_is_a_file_is_said_in_a_sentence(tmp_path: Path) -> None:
    (tmp_path / "demo").write_text("")
    with pytest.raises(ConfigError, match="--out"):
        fresh_folder(tmp_path / "demo")


def test_a_port_in_use_is_said_before_anything_starts() -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        with pytest.raises(ConfigError, match=r"port \d+ is in use.*--port"):
            require_free(other.getsockname()[1])


@pytest.mark.parametrize("verdict", ['{"passed": true, "right": 30}', None])
def test_what_fails_later_leaves_the_verdict_as_it_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, verdict: str | None
) -> None:
    def fail(options: DemoOptions, *_: object) -> bool:
        if verdict is not None:
            (options.out / "results.json").write_text(verdict)
        raise RobotSystemError("the station has ended")

    monkeypatch.setattr(demo, "run_steps", fail)
    options = DemoOptions(1, once=False, port=0, world="small", backend=None, out=tmp_path)
    with pytest.raises(RobotSystemError):
        demo.run_in(options, tmp_path / "data", print)
    said = json.loads((tmp_path / "results.json").read_text())
    assert said["error"] == "the station has ended" and said["passed"] is (verdict is not None)


def test_two_demos_do_not_share_a_folder(tmp_path: Path) -> None:
    with alone_in(tmp_path / "demo"), pytest.raises(ConfigError, match="another demo"), alone_in(tmp_path / "demo"):
        pass
    with alone_in(tmp_path / "demo"):
        pass


async def test_the_demo_asks_a_station_what_it_can_answer(tmp_path: Path) -> None:
    drive = keep_navigation(tmp_path / "data", "nav-1")
    said: list[str] = []
    options = DemoOptions(seed=1, once=True, port=0, out=tmp_path, world="small", backend=None)
    async with running_station(1, tmp_path / "data") as desk:
        with Programs(tmp_path / "logs") as programs, socket.create_server(("127.0.0.1", 0)) as nobody:
            port = nobody.getsockname()[1]
            simulator = SimulatorClient(port)
            demo = Demo(options, programs, StationClient(desk.address), simulator, port, said.append)
            await asyncio.to_thread(wait_for_slam, demo, "Navigation1", drive.id)
            await asyncio.to_thread(finish, demo, drive.id)
            await asyncio.to_thread(finish, demo, "nav-nothing")  # what it meets is said; the verdict stands
            simulator.close()
    ending = "Navigation2: SLAM finishes it, for the library"
    assert said.count(ending) == 2
    said = [words for words in said if words != ending]
    assert len(said) == 3 and "Navigation1: " in said[0] and "5 landmarks (sfm, metric scale)" in said[0]
    assert said[1] == said[0].replace("Navigation1", "Navigation2")
    assert said[2].startswith("Navigation2: ") and "nav-nothing" in said[2]
