"""The way of a new robot: built with another camera than it tells, calibrated on the page before a board that a script
holds, and telling its own camera from then on.
"""

from __future__ import annotations

import asyncio
import socket
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest
from playwright.async_api import Browser, Locator, expect

from robot.simulation.config import BuildErrors
from robot.simulation.construction import built_camera
from shared.calibration import REFERENCE_ROBOT
from shared.simulator_link import SimulatorLink
from tests.e2e.conftest import LAPTOP
from tests.support.board_bench import looked_at
from tests.support.programs import program, said
from tests.support.station import Desk, running_station

pytestmark = [
    pytest.mark.browser,
    pytest.mark.slow,
    pytest.mark.timeout(900),
    pytest.mark.asyncio(loop_scope="module"),
]

BUILD_SEED = 4
TAG_MM, GAP_MM = 34.0, 10.2
# As a person holds it before the reference robot's camera: distance (m), to the right and down (m), turned (degrees).
HELD: list[dict[str, float]] = [
    *({"distance_m": 0.95, "right_m": x, "down_m": y} for x in (-0.16, 0.16) for y in (-0.1, 0.1)),
    *({"distance_m": 0.8, "pitch_deg": p, "right_m": 0.05} for p in (-30.0, -24.0, 24.0, 30.0)),
    *({"distance_m": 0.8, "yaw_deg": w, "down_m": 0.04} for w in (-32.0, -25.0, 25.0, 32.0)),
    *({"distance_m": 0.6, "pitch_deg": p, "yaw_deg": w, "roll_deg": 8.0} for p in (-20.0, 20.0) for w in (-20.0, 20.0)),
    *({"distance_m": 1.5, "right_m": x, "yaw_deg": 30.0 * x / 0.2} for x in (-0.2, 0.2)),
]


@asynccontextmanager
async def new_robot(folder: Path) -> AsyncIterator[tuple[int, SimulatorLink]]:
    """The port of a simulated robot that is built otherwise than it tells, and the hands of its simulator."""
    settings, config = folder / "simulation.toml", folder / "robot.toml"
    settings.write_text(f"[build]\nseed = {BUILD_SEED}\n")
    config.write_text(
        f'[simulated]\nworld = "small"\nsettings = "{settings}"\n[calibration]\nfolder = "{folder / "own"}"\n'
    )
    sim_port = free_port()
    words = (
        "robot.main",
        "--devices",
        "simulated",
        "--config",
        str(config),
        "--port",
        "0",
        "--sim-port",
        str(sim_port),
    )
    async with program(*words) as robot:
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


async def hold_everywhere(desk: Desk, simulator: SimulatorLink, nearer: float) -> None:
    """Each pose until it was looked at, at `nearer` times its distance, as a camera of another view needs it."""
    for place in HELD:
        there = place | {"distance_m": nearer * place["distance_m"]}
        await asyncio.to_thread(simulator.ask, cmd="board", tag_m=TAG_MM / 1000, **there)
        truth = await asyncio.to_thread(simulator.ask, cmd="truth")
        await looked_at(desk, truth["t_robot_ns"])


async def choose_own_board(dialog: Locator) -> None:
    """The simulator's board is of a size of its own."""
    await dialog.get_by_label("Paper").select_option("other")
    for label, value in (("Tag or square, mm", TAG_MM), ("Gap or marker, mm", GAP_MM)):
        await dialog.get_by_label(label).fill(str(value))


async def test_a_robot_built_otherwise_than_it_tells_is_calibrated_and_tells_its_own_camera(
    browser: Browser, tmp_path: Path
) -> None:
    told = REFERENCE_ROBOT.camera
    assert told is not None
    built = built_camera(told, BuildErrors(seed=BUILD_SEED))
    assert abs(built.fx / told.fx - 1) > 0.05  # else there is nothing to find
    async with new_robot(tmp_path) as (port, simulator), running_station(port, tmp_path / "station") as desk:
        context = await browser.new_context(**LAPTOP)
        page = await context.new_page()
        page.set_default_timeout(90_000)
        await page.goto(desk.address)
        await page.wait_for_selector("#video[data-seq]")
        await page.locator("#calibrate").click()
        dialog = page.locator("#calibrate-dialog")
        await expect(dialog).to_contain_text(f"focal length {told.fx:.1f}")
        await choose_own_board(dialog)
        await dialog.get_by_role("button", name="Begin").click()
        await expect(dialog.get_by_role("button", name="Finish")).to_be_disabled()
        await hold_everywhere(desk, simulator, built.fx / told.fx)
        await dialog.get_by_role("button", name="Finish").click()
        await expect(dialog.locator(".verdict")).to_have_text("This calibration is good.", timeout=300_000)
        await dialog.get_by_role("button", name="Use it").click()
        await expect(dialog).to_contain_text("The robot tells these numbers now")
        fx, fy, cx, cy = (await desk.http.get("/calibration")).json()["camera"]["intrinsics"]
        assert (fx, fy) == pytest.approx((built.fx, built.fy), rel=0.01)
        assert (cx, cy) == pytest.approx((built.cx, built.cy), abs=8.0)
        assert "intrinsics" in (tmp_path / "own" / "calibration.yaml").read_text()
        await context.close()
