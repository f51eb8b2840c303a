"""How quick is the page: drive event to motor command, capture to canvas, with video, SLAM and a growing cloud.

python -m benchmarks.bench_page [--seconds 30] [--results FILE]          (make bench-page)

A robot-server with pushed devices (30 fps, IMU) runs here, the station in a process of its own, the page in headless
Chromium with software rendering. SLAM is made up: it costs 10 ms a frame and sends 50,000 points, then 500 a second.
Then, with a station of its own: 200,000 points turned by hand, and how soon a fresh page shows what one came for. Then,
with another one, whose map is a home of 1000 rooms: how soon its plan is drawn.
"""

from __future__ import annotations

import argparse
import asyncio
import os
import shutil
import socket
import statistics
import sys
import tempfile
import time
import urllib.request
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from playwright.async_api import Browser, Page, async_playwright

from benchmarks.page_cloud import measure_first_paint, measure_orbit
from benchmarks.page_plan import measure_plan, store_large_home
from benchmarks.result import Figure, Run, add_results_option, share
from robot.devices.ports import CapturedFrame
from shared.calibration import Calibration
from station.model.frames import ImageFrame
from station.model.slam_update import SlamUpdate
from tests.support.link import Bench, running_robot, until
from tests.support.made_up_workers import StraightSlam
from tests.support.paths import ROOT
from tests.support.station import picture

FRAME_S = 1 / 30
CHROMIUM_ARGUMENTS = [
    "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync", "--use-gl=angle", "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
]  # fmt: skip
WATCH_CANVAS = """() => {
  window.drawn = [];
  const canvas = document.getElementById('video');
  const cells = Array.from({length: 7}, (_, i) => i);
  const stamp = () => {  // what is on the canvas, not what its header says
    const pixels = canvas.getContext('2d').getImageData(0, 8, 7 * 16, 1).data;
    return cells.reduce((number, i) => number + (pixels[4 * (16 * i + 8)] > 128 ? 2 ** i : 0), 0);
  };
  new MutationObserver(() => {
    const at = performance.timeOrigin + performance.now();
    drawn.push([Number(canvas.dataset.seq), at, stamp()]);
  }).observe(canvas, {attributes: true, attributeFilter: ['data-seq']});
}"""
STAMPS = 128  # pictures with a stamp of their own: seven cells of 16 pixels, white or black
PRESS = """(type) => {
  const at = performance.timeOrigin + performance.now();
  dispatchEvent(new KeyboardEvent(type, {code: 'KeyW', bubbles: true}));
  return at;
}"""


class BusySlam(StraightSlam):
    """Costs what a filter costs, and sends a cloud that grows."""

    def __init__(self, calibration: Calibration) -> None:
        super().__init__(calibration)
        self._random = np.random.default_rng(1)

    def add_frame(self, frame: ImageFrame) -> SlamUpdate:
        end = time.perf_counter() + 0.01
        update = super().add_frame(frame)
        count = 50_000 if len(self.frames) == 1 else 500 if len(self.frames) % 30 == 0 else 0
        points = self._random.uniform([-5, -5, 0], [5, 5, 2], (count, 3))
        while time.perf_counter() < end:
            pass
        return SlamUpdate(
            update.t_robot_ns, "tracking", "busy", update.T_world_body, count, False, points, points * 25 + 100
        )


@dataclass(frozen=True, slots=True)
class Spread:
    """Milliseconds."""

    p50: float
    p99: float
    worst: float
    count: int

    @classmethod
    def of(cls, values: list[float]) -> Spread:
        return cls(
            round(statistics.median(values), 2),
            round(float(np.percentile(values, 99)), 2),
            round(max(values), 2),
            len(values),
        )


def stamped(number: int) -> bytes:
    """A JPEG whose top left corner says its number, modulo STAMPS."""
    image = cv2.imdecode(np.frombuffer(picture(number % 10), np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    for cell in range(7):
        image[:16, 16 * cell : 16 * (cell + 1)] = 255 * (number >> cell & 1)
    return cv2.imencode(".jpg", image)[1].tobytes()


async def film(bench: Bench, captured: dict[int, float]) -> None:
    """Frames at 30 fps, IMU with each; keeps each one's wall time in ms."""
    pictures = [stamped(n) for n in range(STAMPS)]
    due = time.monotonic()
    count = 0
    while True:
        captured[count] = time.time() * 1e3
        bench.camera.frames.put_nowait(
            CapturedFrame(time.monotonic_ns(), 5_000_000, 640, 480, pictures[count % len(pictures)])
        )
        bench.imu.inject_until(time.monotonic_ns())
        count += 1
        due = max(due + FRAME_S, time.monotonic() - 0.1)
        await asyncio.sleep(max(0.0, due - time.monotonic()))


async def measure_drive(page: Page, bench: Bench, presses: int) -> tuple[list[float], int]:
    """Milliseconds from the key event in the page to the motors' command; and how often the page refused to drive."""
    wall_minus_monotonic_ms = time.time() * 1e3 - time.monotonic() * 1e3
    times: list[float] = []
    refused = 0
    for _ in range(presses):
        await until(lambda: bench.motors.are_off)
        await asyncio.sleep(0.05)
        begun = len(bench.motors.history)
        pressed_ms = await page.evaluate(PRESS, "keydown")
        give_up = time.monotonic() + 1.0
        while time.monotonic() < give_up and not any(entry[1] > 0 for entry in bench.motors.history[begun:]):
            await asyncio.sleep(0.002)
        moved_ns = next((entry[0] for entry in bench.motors.history[begun:] if entry[1] > 0), None)
        if moved_ns is None:  # the picture was older than 500 ms at this moment: the page does not drive blind
            refused += 1
        else:
            times.append(moved_ns / 1e6 + wall_minus_monotonic_ms - pressed_ms)
        await page.evaluate(PRESS, "keyup")
    return times, refused


async def run(seconds: float) -> dict[str, Any]:
    """All parts, one after the other: each with a robot, a station and a browser of its own."""

    async def measure(address: str, bench: Bench, captured: dict[int, float]) -> dict[str, Any]:
        return await _measure(address, bench, captured, seconds)

    return await _with_station("benchmarks.bench_page:BusySlam", measure) | {
        "cloud_200k": await _with_station("benchmarks.page_cloud:LargeCloud", _measure_cloud),
        "plan_1000": await _with_station("benchmarks.bench_page:BusySlam", _measure_plan, store_large_home),
    }


Measurement = Callable[[str, Bench, dict[int, float]], Awaitable[dict[str, Any]]]


async def _with_station(
    slam: str, measure: Measurement, furnish: Callable[[Path], object] = lambda _: None
) -> dict[str, Any]:
    """`furnish`: puts something into the station's folder of data."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    address = f"http://127.0.0.1:{port}"
    captured: dict[int, float] = {}
    with tempfile.TemporaryDirectory() as data:
        furnish(Path(data))
        async with running_robot() as bench:
            bench.motors.stop()
            filming = asyncio.create_task(film(bench, captured))
            station = await asyncio.create_subprocess_exec(
                sys.executable,
                *("-m", "station.main", "serve", "--port", str(port), "--robot", f"127.0.0.1:{bench.port}"),
                *("--data", data, "--backend", slam),
                cwd=ROOT,
            )
            try:
                return await measure(address, bench, captured)
            finally:
                station.terminate()
                await station.wait()
                filming.cancel()
                await asyncio.gather(filming, return_exceptions=True)


@asynccontextmanager
async def _browser() -> AsyncIterator[Browser]:
    async with async_playwright() as playwright:
        chromium = shutil.which("chromium") or shutil.which("google-chrome")
        browser = await playwright.chromium.launch(executable_path=chromium, args=CHROMIUM_ARGUMENTS)
        try:
            yield browser
        finally:
            await browser.close()


async def _new_page(browser: Browser, address: str) -> Page:
    page = await browser.new_page(viewport={"width": 1440, "height": 900})
    for _ in range(200):
        try:
            await page.goto(address)
            break
        except Exception:  # the station is not up yet
            await asyncio.sleep(0.1)
    return page


async def _recording_page(browser: Browser, address: str) -> Page:
    """A page with live video while a drive is recorded and its cloud is shown."""
    page = await _new_page(browser, address)
    await page.wait_for_selector("#video[data-seq]")
    await page.wait_for_selector("#link[data-state=good]")
    request = urllib.request.Request(address + "/navigations", method="POST")
    await asyncio.to_thread(lambda: urllib.request.urlopen(request, timeout=20).read())
    await page.wait_for_selector("#map-count:has-text('landmarks')", timeout=60_000)
    await page.wait_for_selector(".age:not(.bad)")
    return page


async def _measure_cloud(address: str, _bench: Bench, _captured: dict[int, float]) -> dict[str, Any]:
    """Turning 200,000 points with live video beside it, then how soon fresh pages show something."""
    async with _browser() as browser:
        page = await _recording_page(browser, address)
        points = await page.locator("#map-count").text_content()
        orbit = await measure_orbit(page)
        await page.close()
        first = await measure_first_paint(browser, address)
    return {"cloud": points, "orbit": orbit, "first": first, "load_average": round(os.getloadavg()[0], 1)}


async def _measure_plan(address: str, _bench: Bench, _captured: dict[int, float]) -> dict[str, Any]:
    async with _browser() as browser:
        page = await _new_page(browser, address)
        await page.close()
        request = urllib.request.Request(
            f"{address}/maps/active", b'{"id": "map"}', {"Content-Type": "application/json"}, method="PUT"
        )
        await asyncio.to_thread(lambda: urllib.request.urlopen(request, timeout=20).read())
        return await measure_plan(browser, address)


async def _measure(address: str, bench: Bench, captured: dict[int, float], seconds: float) -> dict[str, Any]:
    async with _browser() as browser:
        page = await _recording_page(browser, address)
        await page.evaluate(WATCH_CANVAS)
        begun = time.monotonic()
        drive_ms, refused = await measure_drive(page, bench, presses=max(20, int(seconds * 4)))
        await asyncio.sleep(max(0.0, seconds - (time.monotonic() - begun)))
        elapsed_s = time.monotonic() - begun
        drawn = await page.evaluate("() => drawn")
        points = await page.locator("#map-count").text_content()
    video_ms = [at - captured[int(seq)] for seq, at, _ in drawn if int(seq) in captured]
    misread = sum(int(seq) % STAMPS != stamp for seq, _, stamp in drawn)
    return {
        "drive_event_to_motor_ms": asdict(Spread.of(drive_ms)),
        "refused_for_stale_video": refused,
        "capture_to_canvas_ms": asdict(Spread.of(video_ms)),
        "frames_per_s": round(len(drawn) / elapsed_s, 1),
        "stamps_not_of_their_picture": misread,
        "cloud": points,
        "load_average": round(os.getloadavg()[0], 1),
        "cores": os.cpu_count(),
    }


def page_weight_mb() -> float:
    """What a browser loads to show the page, uncompressed and without pictures: index.html, script, style."""
    dist = ROOT / "station" / "web" / "dist"
    return round(sum(f.stat().st_size for f in (dist / "index.html", *(dist / "assets").iterdir())) / 1e6, 2)


def table(result: dict[str, Any]) -> str:
    """What was measured beside what was asked for."""
    drive, video, cloud = result["drive_event_to_motor_ms"], result["capture_to_canvas_ms"], result["cloud_200k"]
    first, refused, plan = cloud["first"], result["refused_for_stale_video"], result["plan_1000"]
    rows = [
        ("drive event to motor command, p50", f"{drive['p50']} ms", "5 ms"),
        ("drive event to motor command, p99", f"{drive['p99']} ms (worst {drive['worst']})", "25 ms"),
        ("presses, of them refused for a stale picture", f"{drive['count'] + refused}, {refused}", "-"),
        ("capture to canvas, p50", f"{video['p50']} ms", "40 ms"),
        ("capture to canvas, p99", f"{video['p99']} ms (worst {video['worst']})", "120 ms"),
        ("pictures drawn", f"{result['frames_per_s']} /s", ">= 20 /s"),
        ("of them with another stamp in the picture", f"{result['stamps_not_of_their_picture']}", "0"),
        (f"redraws while orbiting {cloud['cloud']}", f"{cloud['orbit']['redraws_per_s']} /s", ">= 10 /s"),
        ("first useful paint: place and picture", f"{max(first['place_ms'], first['picture_ms'])} ms", "1500 ms"),
        ("first contentful paint", f"{first['first_contentful_paint_ms']} ms", "-"),
        ("all 200,000 points on the screen", f"{first['cloud_ms']} ms", "-"),
        (
            f"plan of {plan['rooms']:.0f} rooms drawn",
            f"{plan['drawn_ms']:.0f} ms (read {plan['read_ms']:.0f})",
            "1000 ms",
        ),
        ("page without pictures, uncompressed", f"{result['page_mb']} MB", "1.5 MB"),
        ("load average before, cores", f"{result['load_before']}, {result['cores']}", "-"),
    ]
    lines = [f"| {name} | {value} | {bound} |" for name, value, bound in rows]
    return "\n".join(["| figure | measured | bound |", "| --- | --- | --- |", *lines])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=30.0)
    add_results_option(parser, "page")
    options = parser.parse_args()
    this_run = Run.begin()
    before = {"load_before": round(os.getloadavg()[0], 1), "page_mb": page_weight_mb()}
    result = asyncio.run(run(options.seconds)) | before
    print(table(result))
    this_run.write(options.results, figures(result))


def figures(result: dict[str, Any]) -> list[Figure]:
    """What is asked of the page."""
    drive, video, cloud = result["drive_event_to_motor_ms"], result["capture_to_canvas_ms"], result["cloud_200k"]
    first, refused, plan = cloud["first"], result["refused_for_stale_video"], result["plan_1000"]
    paint_ms = max(first["place_ms"], first["picture_ms"])
    return [
        Figure("drive event in the page to motor command, median", drive["p50"], "ms", 5, of=drive["count"]),
        Figure("drive event in the page to motor command, 99 %", drive["p99"], "ms", 25, of=drive["count"]),
        share("presses refused for a picture that was too old", refused, drive["count"] + refused),
        Figure("capture to the page's canvas, median", video["p50"], "ms", 40, of=video["count"]),
        Figure("capture to the page's canvas, 99 %", video["p99"], "ms", 120, of=video["count"]),
        Figure("pictures drawn", result["frames_per_s"], "/s", at_least=20),
        Figure("redraws while 200,000 points are turned", cloud["orbit"]["redraws_per_s"], "/s", at_least=10),
        Figure("first useful paint: place and picture", paint_ms, "ms", 1500),
        Figure(f"plan of {plan['rooms']:.0f} rooms: asked for, read and drawn", plan["drawn_ms"], "ms", 1000),
        Figure("page without pictures, uncompressed", result["page_mb"], "MB", 1.5),
    ]


if __name__ == "__main__":
    main()
