"""A simulated robot that is built otherwise than it tells, and a script's hands that hold its board and wave it."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from itertools import product
from pathlib import Path

import httpx
import numpy as np
from playwright.async_api import Locator, Page, expect

from shared.errors import ConfigError
from shared.simulator_link import SimulatorLink
from tests.support.board_bench import looked_at
from tests.support.programs import program, said

TAG_MM, GAP_MM = 34.0, 10.2  # of the simulator's board, 6 by 6 tags
BOARD = {"tag_m": TAG_MM / 1000}
WAVED_AT_M = 0.9  # before the reference robot's camera
CARRIED_BEFORE_M = 1.2  # what the robot is turned about: nothing, or furniture
BUTTONS = {"straight on": "Forth", "straight back": "Back", "to the left": "Turn left", "to the right": "Turn right"}
HELD_S = 2.0  # a button to drive by
STEP_BACK_M = 0.4  # from the middle of a room
SEEN_WHOLE = 120  # of the board's 144 corners
# As a person holds it before the reference robot's camera: distance (m), to the right and down (m), turned (degrees).
HELD: list[dict[str, float]] = [
    *({"distance_m": 0.95, "right_m": x, "down_m": y} for x in (-0.16, 0.16) for y in (-0.1, 0.1)),
    *({"distance_m": 0.8, "pitch_deg": p, "right_m": 0.05} for p in (-30.0, -24.0, 24.0, 30.0)),
    *({"distance_m": 0.8, "yaw_deg": w, "down_m": 0.04} for w in (-32.0, -25.0, 25.0, 32.0)),
    *({"distance_m": 0.6, "pitch_deg": p, "yaw_deg": w, "roll_deg": 8.0} for p in (-20.0, 20.0) for w in (-20.0, 20.0)),
    *({"distance_m": 1.5, "right_m": x, "yaw_deg": 30.0 * x / 0.2} for x in (-0.2, 0.2)),
]

WAYS_OFF_M = [place["distance_m"] for place in HELD]


def write_settings(folder: Path, build: dict[str, float], camera_rate_hz: float = 20.0) -> Path:
    """The settings of a robot that is built so (robot/simulation/config.py, BuildErrors) and keeps its calibration."""
    settings, config = folder / "simulation.toml", folder / "robot.toml"
    building = "".join(f"{name} = {value}\n" for name, value in build.items())
    settings.write_text(f"camera_rate_hz = {camera_rate_hz}\n[build]\n{building}")
    config.write_text(
        f'[simulated]\nworld = "small"\nsettings = "{settings}"\n[calibration]\nfolder = "{folder / "own"}"\n'
    )
    return config


@asynccontextmanager
async def new_robot(
    folder: Path, build: dict[str, float], camera_rate_hz: float = 20.0
) -> AsyncIterator[tuple[int, SimulatorLink]]:
    """The port of a simulated robot that is built otherwise than it tells, and the hands of its simulator."""
    sim_port = free_port()
    settings = write_settings(folder, build, camera_rate_hz)
    words = ("--devices", "simulated", "--config", str(settings), "--port", "0")
    async with program("robot.main", *words, "--sim-port", str(sim_port)) as robot:
        port = int((await said(robot, r"on 127\.0\.0\.1:(\d+)")).group(1))
        simulator = await asyncio.to_thread(SimulatorLink, sim_port)
        try:
            yield port, simulator
        finally:
            simulator.close()


def free_port() -> int:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


async def stand_in_the_open(http: httpx.AsyncClient, simulator: SimulatorLink, nearer: float) -> None:
    """Carry the robot to where nothing hides a board before it, as somebody would; a session must look meanwhile."""
    rooms = (await asyncio.to_thread(simulator.ask, cmd="flat"))["rooms"]
    for room, yaw in product(rooms, np.radians([0.0, 90.0, 180.0, 270.0]).tolist()):
        x = 0.5 * (room["x0_m"] + room["x1_m"]) - STEP_BACK_M * np.cos(yaw)
        y = 0.5 * (room["y0_m"] + room["y1_m"]) - STEP_BACK_M * np.sin(yaw)
        try:
            put = await asyncio.to_thread(simulator.ask, cmd="hijack", x=float(x), y=float(y), yaw=yaw)
        except ConfigError:
            continue  # something stands there
        while (await asyncio.to_thread(simulator.ask, cmd="truth"))["t_robot_ns"] < put["t_end_ns"]:
            await asyncio.sleep(0.1)
        await asyncio.to_thread(simulator.ask, cmd="board", **BOARD, distance_m=nearer * max(WAYS_OFF_M))
        truth = await asyncio.to_thread(simulator.ask, cmd="truth")
        if len((await looked_at(http, truth["t_robot_ns"]))["corners_px"]) > SEEN_WHOLE:
            return
    raise ConfigError("in this flat is no place for a board before the robot")


async def hold(http: httpx.AsyncClient, simulator: SimulatorLink, nearer: float, place: dict[str, float]) -> None:
    """The board until it was looked at, at `nearer` times its distance, as a camera of another view needs it."""
    there = place | {"distance_m": nearer * place["distance_m"]}
    await asyncio.to_thread(simulator.ask, cmd="board", **BOARD, **there)
    truth = await asyncio.to_thread(simulator.ask, cmd="truth")
    await looked_at(http, truth["t_robot_ns"])


async def hold_everywhere(http: httpx.AsyncClient, simulator: SimulatorLink, nearer: float) -> None:
    for place in HELD:
        await hold(http, simulator, nearer, place)
    await asyncio.to_thread(simulator.ask, cmd="board", gone=True)


async def wave_until_all_is_recorded(dialog: Locator, simulator: SimulatorLink, nearer: float, seconds: float) -> None:
    """Begin, wave, finish; again where the computer stood still meanwhile, as the page then asks."""
    while True:
        await dialog.get_by_role("button", name="Begin").click()
        await expect(dialog.get_by_role("list", name="Views")).to_contain_text("roll", timeout=90_000)
        finish = dialog.get_by_role("button", name="Finish")
        await expect(finish).to_be_disabled(timeout=90_000)
        place = BOARD | {"distance_m": WAVED_AT_M * nearer}
        while await finish.is_disabled():  # on a busy computer the pictures of once may be too few
            await asyncio.to_thread(simulator.ask, cmd="wave", seconds=seconds, **place)
            await asyncio.sleep(seconds)
            while (await asyncio.to_thread(simulator.ask, cmd="truth"))["carried"]:
                await asyncio.sleep(0.5)
        await finish.click()
        await expect(dialog.locator(".verdict")).to_be_visible(timeout=600_000)
        await asyncio.to_thread(simulator.ask, cmd="board", gone=True)
        if "the IMU fell silent" not in await dialog.inner_text():
            return
        await dialog.get_by_role("button", name="Again").click()


async def carry_about_until_all_is_recorded(
    dialog: Locator, http: httpx.AsyncClient, simulator: SimulatorLink, seconds: float
) -> None:
    """Begin, carry the robot about in the open with no board in view, finish; again where the IMU fell silent."""
    while True:
        await dialog.get_by_role("button", name="Begin").click()
        finish = dialog.get_by_role("button", name="Finish")
        await expect(finish).to_be_disabled(timeout=90_000)
        instruction = dialog.locator(".instruction")
        while "finish" not in await instruction.inner_text():
            await asyncio.to_thread(simulator.ask, cmd="wave", seconds=seconds, distance_m=CARRIED_BEFORE_M)
            await asyncio.to_thread(simulator.ask, cmd="board", gone=True)
            while (await asyncio.to_thread(simulator.ask, cmd="truth"))["carried"]:
                if "finish" in await instruction.inner_text():
                    break
                await asyncio.sleep(0.5)
        await finish.click()
        await expect(dialog.locator(".verdict")).to_be_visible(timeout=600_000)
        if "the IMU fell silent" not in await dialog.inner_text():
            return
        await dialog.get_by_role("button", name="Again").click()


async def drive_until_all_goes_straight(dialog: Locator, http: httpx.AsyncClient, simulator: SimulatorLink) -> None:
    """Begin, drive, finish; again where commands came late on a busy computer, as the page then asks, twice at most."""
    for attempt in range(3):
        if attempt:
            await dialog.get_by_role("button", name="Again").click()
        await dialog.get_by_role("button", name="Begin").click()
        await stand_in_the_open(http, simulator, 1.0)
        await drive_as_told(dialog)
        await dialog.get_by_role("button", name="Finish").click()
        await expect(dialog.locator(".verdict")).to_be_visible(timeout=600_000)
        if "drives differ" not in await dialog.inner_text():
            return


async def drive_as_told(dialog: Locator) -> None:
    """Hold the button that the dialog names, let go, and wait for its next word, until it has enough."""
    while "Enough" not in (said := await dialog.locator(".instruction").inner_text()):
        name = next((button for words, button in BUTTONS.items() if words in said), None)
        if name is not None:
            await dialog.get_by_role("button", name=name).hover()
            await dialog.page.mouse.down()
            await asyncio.sleep(HELD_S)
            await dialog.page.mouse.up()
        await asyncio.sleep(0.5)  # until the station has seen it


async def open_dialog(page: Page, address: str) -> Locator:
    """The page's dialog, opened as a person does."""
    page.set_default_timeout(90_000)
    await page.goto(address)
    await page.wait_for_selector("#video[data-seq]")
    await page.locator("#calibrate").click()
    return page.locator("#calibrate-dialog")


async def choose_own_board(dialog: Locator) -> None:
    """The simulator's board is of a size of its own."""
    await dialog.get_by_label("Paper").select_option("other")
    for label, value in (("Tag or square, mm", TAG_MM), ("Gap or marker, mm", GAP_MM)):
        await dialog.get_by_label(label).fill(str(value))
