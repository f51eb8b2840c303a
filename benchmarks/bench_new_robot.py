"""The way of a new robot, each of another make, as a person goes it: from a calibration that does not fit to the place.

    python -m benchmarks.bench_new_robot [--seeds 0-4] [--results FILE]

A simulated robot is built as its seed says (lens, mounting, time shift, line delay: `robot-sim calibration`) and tells
the reference robot's calibration. It maps a small flat: what is said of its calibration? Then the page's guided
calibration in headless Chromium, camera first, then camera and IMU, while a script holds the simulated board and waves
the robot before it; *Use it* each time. Then a mapping drive, a map of it, a hijack, another drive, and
`GET /place/current`, judged by the simulator's truth as `station demo` judges. Programs, SLAM and localiser are the
real ones, in real time: some eight minutes each. What each came to is a line of a file; started again with the same
code it goes on where it ended.
"""

from __future__ import annotations

import argparse
import asyncio
import shutil
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import httpx
import numpy as np
from playwright.async_api import Error as PlaywrightError
from playwright.async_api import Locator, ViewportSize, async_playwright, expect

from benchmarks.bench_demo import PASSED_PERCENT
from benchmarks.bench_mapping import parse_seeds
from benchmarks.bench_page import CHROMIUM_ARGUMENTS
from benchmarks.result import Figure, Run, add_results_option, failed_seeds, rows_by_seed, share, work_folder
from robot.simulation.config import BuildErrors
from robot.simulation.construction import built_camera
from shared.calibration import REFERENCE_CAMERA, CameraCalibration
from shared.errors import RobotSystemError
from shared.geometry import so3_log
from station.demo.demo import (
    Demo,
    DemoOptions,
    Timings,
    describe,
    map_hijack_and_ask,
    record_mapping,
    start_programs,
    wait_for_slam,
)
from station.demo.processes import Programs
from tests.support.new_robot import (
    choose_own_board,
    hold_everywhere,
    open_dialog,
    stand_in_the_open,
    wave_until_all_is_recorded,
    write_settings,
)

WAVED_S = 30.0
LAPTOP: ViewportSize = {"width": 1440, "height": 900}
MISFIT = "does not fit"


def go_the_way(seed: int) -> dict[str, Any]:
    """What one robot's way came to; where it ended early, why."""
    begun_s = time.monotonic()
    row: dict[str, Any] = {"seed": seed, "passed": False}
    with tempfile.TemporaryDirectory(prefix="new-robot-") as folder, Programs(Path(folder) / "logs") as programs:
        out = Path(folder)
        options = DemoOptions(seed=seed, once=True, port=0, world="small", backend=None, out=out)
        try:
            demo = start_programs(options, programs, out / "data", say, write_settings(out, {"seed": seed}))
            row["before"] = drive_uncalibrated(demo)
            row |= asyncio.run(calibrate_on_the_page(demo, seed))
            verdict = map_hijack_and_ask(demo, out / "data", Timings()).verdict
            say(describe(verdict))
            row |= {"passed": verdict.passed, "shortfall": verdict.shortfall, "map_error_m": verdict.map_error_m}
            row |= {"right": verdict.right, "wrong": verdict.wrong, "not_known": verdict.not_known}
            row["after"] = demo.station.get("/robot")["calibration_fit"]
        except (RobotSystemError, PlaywrightError, AssertionError) as exc:
            row["ended"] = str(exc)[:500]
    return row | {"seconds": round(time.monotonic() - begun_s)}


def say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def drive_uncalibrated(demo: Demo) -> dict[str, Any]:
    """What is said of the calibration after a mapping drive with another robot's; the navigation may well fail."""
    navigation = record_mapping(demo, "Before")
    try:
        wait_for_slam(demo, "Before", navigation)
    except RobotSystemError as exc:
        say(f"Before: {exc}")
    record = demo.station.get(f"/navigations/{navigation}")
    return {
        "fit": demo.station.get("/robot")["calibration_fit"],
        **{name: record[name] for name in ("state", "message", "landmarks")},
    }


async def calibrate_on_the_page(demo: Demo, seed: int) -> dict[str, Any]:
    """Camera, then camera and IMU; how far what the robot tells afterwards is from how it is built."""
    built = built_camera(REFERENCE_CAMERA, BuildErrors(seed=seed))
    nearer = built.fx / REFERENCE_CAMERA.fx
    address = demo.station.address
    async with async_playwright() as playwright, httpx.AsyncClient(base_url=address, timeout=20.0) as http:
        chromium = await playwright.chromium.launch(executable_path=shutil.which("chromium"), args=CHROMIUM_ARGUMENTS)
        page = await chromium.new_page(viewport=LAPTOP)
        dialog = await open_dialog(page, address)
        await expect(dialog).to_contain_text("The robot tells")
        said = await dialog.inner_text()
        await choose_own_board(dialog)
        await dialog.get_by_role("button", name="Begin").click()
        await stand_in_the_open(http, demo.simulator, nearer)
        await hold_everywhere(http, demo.simulator, nearer)
        await dialog.get_by_role("button", name="Finish").click()
        await use(dialog, "camera")
        await dialog.get_by_role("button", name="Next").click()
        await wave_until_all_is_recorded(dialog, demo.simulator, nearer, WAVED_S)
        await use(dialog, "camera and IMU")
        found = (await http.get("/calibration")).json()["camera"]
        await page.close()
        await chromium.close()
    return {"page_said_so": MISFIT in said} | errors(found, built)


async def use(dialog: Locator, what: str) -> None:
    """Raises AssertionError: it is refused, with the page's words."""
    await expect(dialog.locator(".verdict")).to_be_visible(timeout=300_000)
    assert await dialog.locator(".verdict.good").count(), f"{what}: {await dialog.inner_text()}"
    await dialog.get_by_role("button", name="Use it").click()
    await expect(dialog).to_contain_text("The robot tells these numbers now", timeout=30_000)
    say(f"{what}: used")


def errors(found: dict[str, Any], built: CameraCalibration) -> dict[str, float]:
    """Of what the robot tells, against how it is built."""
    T, T_true = np.array(found["T_body_cam"]), built.T_body_cam_matrix
    return {
        "focal_percent": 100 * abs(found["intrinsics"][0] / built.fx - 1),
        "turned_deg": float(np.degrees(np.linalg.norm(so3_log(T[:3, :3].T @ T_true[:3, :3])))),
        "moved_mm": 1e3 * float(np.linalg.norm(T[:3, 3] - T_true[:3, 3])),
        "shift_ms": 1e3 * abs(found["time_shift_s"] - built.time_shift_s),
        "line_delay_us": 1e6 * abs(found["line_delay_s"] - built.line_delay_s),
    }


def figures(rows: list[dict[str, Any]]) -> list[Figure]:
    """How many arrived, how many were warned before, how well they were calibrated on the page."""
    passed = sum(row["passed"] for row in rows)
    calibrated = [row for row in rows if "turned_deg" in row]
    right, wrong, not_known = (sum(row.get(key, 0) for row in rows) for key in ("right", "wrong", "not_known"))
    fits = [row.get("before", {}).get("fit") or {} for row in rows]
    warned = sum(fit.get("verdict") == MISFIT for fit in fits)
    doubted = sum("seems" in fit.get("sentence", "") for fit in fits)
    shown = sum(row.get("page_said_so", False) for row in rows)
    worst = {
        "focal length": ("focal_percent", "%"), "rotation": ("turned_deg", "deg"), "position": ("moved_mm", "mm"),
        "time shift": ("shift_ms", "ms"), "line delay": ("line_delay_us", "us"),
    }  # fmt: skip
    return [
        share("new robots that know their place at the end", passed, len(rows), at_least=PASSED_PERCENT,
              note=failed_seeds(rows, lambda row: row.get("shortfall") or row["ended"])),
        share("told before that the calibration does not fit", warned, len(rows)),
        share("told before at least what seems not to fit", doubted, len(rows)),
        share("the page says so where one calibrates", shown, len(rows)),
        share("calibrated on the page, camera and camera with IMU", len(calibrated), len(rows)),
        share("known answers afterwards that are right", right, right + wrong),
        share("answers afterwards that are known", right + wrong, right + wrong + not_known),
        *(
            Figure(f"calibrated on the page: {what}, worst", max((r[key] for r in calibrated), default=None), unit)
            for what, (key, unit) in worst.items()
        ),
    ]  # fmt: skip


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", default="0-4")
    parser.add_argument("--rows", type=Path, help="a line per robot; usually in benchmarks/results/work")
    add_results_option(parser, "new_robot")
    options = parser.parse_args()
    run = Run.begin()
    kept: Path = options.rows or work_folder() / "new_robot.jsonl"
    rows = rows_by_seed(kept, parse_seeds(options.seeds), go_the_way)
    run.write(options.results, figures(rows))
    return 0 if all(row["passed"] for row in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
