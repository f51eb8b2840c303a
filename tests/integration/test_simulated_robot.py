"""The simulated robot in real time, seen through its control port."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import socket
import struct
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from socketserver import ThreadingTCPServer
from typing import Any

import cv2
import numpy as np
import pytest

from robot.devices.ports import Camera, DeviceSet
from robot.devices.simulated import SimulatedRobot, open_simulated
from robot.devices.simulated.control import ControlDesk, ControlServer
from robot.devices.simulated.parts import SimulatedHijack
from robot.simulation.config import SimulationConfig
from shared.errors import ConfigError, DeviceLost, DeviceUnavailable
from tests.support.tags import detect_tags

WAIT_S = 90.0


@pytest.fixture
def robot(textures: Path) -> Iterator[SimulatedRobot]:
    simulated = SimulatedRobot("room", 1, SimulationConfig(), textures)
    simulated.start()
    yield simulated
    simulated.close()


def ask(robot: SimulatedRobot, **question: Any) -> dict[str, Any]:
    return ControlDesk(robot).answer(json.dumps(question).encode())


def wait_for(condition: Any) -> None:
    end = time.monotonic() + WAIT_S
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.01)


def test_driving_moves_the_true_robot_until_the_command_ends(robot: SimulatedRobot) -> None:
    start = ask(robot, cmd="truth")
    robot.command(0.3, 0.0, time.monotonic_ns() + 3_000_000_000)
    wait_for(lambda: abs(ask(robot, cmd="truth")["T_world_body"][0][3] - start["T_world_body"][0][3]) > 0.05)
    wait_for(lambda: max(map(abs, ask(robot, cmd="truth")["v_world"])) < 0.01)  # nobody stopped it: its time is over
    resting = ask(robot, cmd="truth")
    robot.command(0.3, 0.0, time.monotonic_ns() - 1)
    wait_for(lambda: ask(robot, cmd="truth")["t_robot_ns"] > resting["t_robot_ns"] + 500_000_000)
    assert np.allclose(ask(robot, cmd="truth")["T_world_body"], resting["T_world_body"], atol=0.005)


def test_a_hijack_puts_the_robot_where_asked_and_logs_the_truth_on_the_way(robot: SimulatedRobot) -> None:
    answer = ask(robot, cmd="hijack", seed=4)
    assert "error" not in answer
    wait_for(
        lambda: not ask(robot, cmd="truth")["carried"] and ask(robot, cmd="truth")["t_robot_ns"] > answer["t_end_ns"]
    )
    T = ask(robot, cmd="truth")["T_world_body"]
    assert (T[0][3], T[1][3]) == pytest.approx((answer["x"], answer["y"]), abs=1e-3)
    log = ask(robot, cmd="truth_log")
    assert len(log["t_robot_ns"]) == len(log["T_world_body"])
    assert max(T[2][3] for T in log["T_world_body"]) > 0.5


def test_a_hijack_to_anywhere_puts_the_robot_on_free_floor_elsewhere(robot: SimulatedRobot) -> None:
    start = ask(robot, cmd="truth")["T_world_body"]
    SimulatedHijack(robot).hijack_anywhere()
    wait_for(lambda: ask(robot, cmd="truth")["carried"])
    wait_for(lambda: not ask(robot, cmd="truth")["carried"])
    x, y = (ask(robot, cmd="truth")["T_world_body"][axis][3] for axis in (0, 1))
    assert (x - start[0][3]) ** 2 + (y - start[1][3]) ** 2 > 1e-4
    assert robot.world.room_at(x, y)


def test_a_hijack_into_furniture_or_an_unknown_room_is_refused_in_words(robot: SimulatedRobot) -> None:
    box = next(o for o in robot.world.obstacles if o.name != "wall")
    assert "not free floor" in ask(robot, cmd="hijack", x=box.x_m, y=box.y_m, yaw=0.0)["error"]
    assert "no room is called" in ask(robot, cmd="hijack", seed=1, room="ballroom")["error"]
    assert "not finite" in ask(robot, cmd="hijack", x=float("nan"), y=0.0, yaw=0.0)["error"]


def test_questions_it_does_not_understand_get_an_error_not_a_crash(robot: SimulatedRobot) -> None:
    desk = ControlDesk(robot)
    for line in (
        b"",
        b"{",
        b"[]",
        b'{"cmd": "fly"}',
        b'{"cmd": "route", "kind": "spiral"}',
        b'{"cmd": "faults", "x": 1}',
    ):
        assert "error" in desk.answer(line)
    assert ask(robot, cmd="faults", light=0.5)["light"] == 0.5
    assert "error" in ask(robot, cmd="faults", light="dark")
    assert ask(robot, cmd="flat")["rooms"][0]["name"] == "living room"
    assert len(ask(robot, cmd="route", kind="local")["points"]) > 20


def test_control_port_answers_on_loopback_and_a_taken_port_is_named(robot: SimulatedRobot) -> None:
    server = ControlServer(robot, 0)
    try:
        with (
            socket.create_connection(("127.0.0.1", server.port), timeout=WAIT_S) as link,
            link.makefile("rwb") as lines,
        ):
            lines.write(b'{"cmd": "truth"}\n')
            lines.flush()
            assert json.loads(lines.readline())["room"] == "living room"
        with pytest.raises(DeviceUnavailable, match=f"{server.port}"):
            ControlServer(robot, server.port)
    finally:
        server.close()


def test_a_client_that_is_killed_leaves_no_traceback(
    robot: SimulatedRobot, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """The demo ends its driver, whatever it has just asked."""
    ended = threading.Event()
    shut_down = ThreadingTCPServer.shutdown_request
    monkeypatch.setattr(
        ThreadingTCPServer, "shutdown_request", lambda self, request: (shut_down(self, request), ended.set())
    )
    server = ControlServer(robot, 0)
    try:
        with socket.create_connection(("127.0.0.1", server.port), timeout=WAIT_S) as link:
            link.sendall(b'{"cmd": "truth"}\n')
            assert link.recv(1) == b"{"
            # Closing resets the connection, as the end of a process does that has not read everything.
            link.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        assert ended.wait(WAIT_S)
    finally:
        server.close()
    assert capfd.readouterr().err == ""


async def test_lost_samples_leave_a_hole_in_the_sequence() -> None:
    devices: DeviceSet = open_simulated("room", 1, config=SimulationConfig())
    assert devices.imu is not None
    robot = devices.imu._robot  # type: ignore[attr-defined]
    robot.faults = type(robot.faults)(imu_dropout=0.5)
    try:
        await asyncio.wait_for(devices.imu.read(), WAIT_S)
        readings = []
        while len(readings) < 60:
            readings += await asyncio.wait_for(devices.imu.read(), WAIT_S)
        assert readings[-1].sequence - readings[0].sequence > len(readings) + 10
    finally:
        await devices.imu.close()


async def capture_on_and_on(camera: Camera) -> None:
    while True:
        await asyncio.wait_for(camera.capture(), WAIT_S)


async def test_a_camera_whose_process_dies_says_so_and_comes_back(textures: Path) -> None:
    devices = open_simulated("room", 1, cache_dir=textures)
    assert devices.camera is not None
    robot = devices.camera._robot  # type: ignore[attr-defined]
    try:
        before = await asyncio.wait_for(devices.camera.capture(), WAIT_S)
        os.kill(robot.camera_pid, signal.SIGKILL)
        with pytest.raises(DeviceLost, match="process has ended"):
            await capture_on_and_on(devices.camera)
        while True:
            try:
                after = await asyncio.wait_for(devices.camera.capture(), WAIT_S)
                break
            except DeviceLost:
                await asyncio.sleep(0.05)
        assert after.t_robot_ns > before.t_robot_ns
    finally:
        await devices.camera.close()


def test_an_unknown_world_is_refused() -> None:
    with pytest.raises(ConfigError, match="castle"):
        open_simulated("castle", 1)


def test_a_script_holds_a_board_before_the_camera_and_takes_it_away(robot: SimulatedRobot) -> None:
    target = ask(robot, cmd="board", distance_m=1.0, yaw_deg=20.0, right_m=0.02)["target"]
    assert "tagSize: 0.034" in target
    wait_for(lambda: len(tags_in_next_picture(robot)) == 36)
    assert ask(robot, cmd="board", gone=True) == {}
    wait_for(lambda: len(tags_in_next_picture(robot)) == 0)
    assert "distance_m" in ask(robot, cmd="board", distance_m=-1.0)["error"]


def test_a_script_waves_the_robot_before_a_board(robot: SimulatedRobot) -> None:
    before = ask(robot, cmd="truth")
    assert ask(robot, cmd="wave", seconds=6.0)["duration_s"] == 6.0
    wait_for(lambda: max(map(abs, ask(robot, cmd="truth")["omega_body"])) > 0.1)
    assert "moving" in ask(robot, cmd="wave", seconds=6.0)["error"]
    wait_for(lambda: not ask(robot, cmd="truth")["carried"])
    assert np.allclose(ask(robot, cmd="truth")["T_world_body"], before["T_world_body"], atol=0.005)


def tags_in_next_picture(robot: SimulatedRobot) -> set[int]:
    """Ids of the tags that the camera shows."""
    frame = asyncio.run(robot.frame_mailbox.get())[-1]
    image = cv2.imdecode(np.frombuffer(frame.jpeg, np.uint8), cv2.IMREAD_GRAYSCALE)
    assert image is not None
    ids, _ = detect_tags(np.asarray(image, dtype=np.uint8))
    return set((ids // 4).tolist())
