"""Pictures made smaller for thin links are the same pictures."""

from __future__ import annotations

import asyncio
import builtins
import threading
from typing import Any

import cv2
import numpy as np
import pytest

from robot import recompress as recompress_module
from robot.devices.ports import CapturedFrame
from robot.link_meter import LinkMeter
from robot.recompress import Recompressor, recompress
from robot.video import MAX_WAIT_NS, FrameSlot, Picture, VideoStream


def scene(seed: int = 0) -> bytes:
    coarse = np.random.default_rng(seed).integers(0, 255, (60, 80, 3), np.uint8)
    image = cv2.resize(coarse, (640, 480), interpolation=cv2.INTER_CUBIC)
    return bytes(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 90])[1])


def image_of(jpeg: bytes) -> Any:
    return cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR).astype(int)


def without(monkeypatch: pytest.MonkeyPatch, *names: str) -> None:
    own_import = builtins.__import__

    def refuse(name: str, *rest: Any, **options: Any) -> Any:
        if name.partition(".")[0] in names:
            raise ImportError(name)
        return own_import(name, *rest, **options)

    monkeypatch.setattr(builtins, "__import__", refuse)


@pytest.mark.parametrize("missing", [(), ("cv2",)])
def test_a_lower_quality_is_smaller_and_shows_the_same(
    monkeypatch: pytest.MonkeyPatch, missing: tuple[str, ...]
) -> None:
    jpeg = scene()
    whole = image_of(jpeg)
    without(monkeypatch, *missing)
    good, poor = recompress(jpeg, 50), recompress(jpeg, 20)
    monkeypatch.undo()
    assert len(poor) < len(good) < len(jpeg)
    assert image_of(poor).shape == (480, 640, 3)
    assert np.abs(image_of(poor) - whole).mean() < 12


def test_what_is_no_picture_or_gets_no_smaller_stays_as_it_was() -> None:
    assert recompress(b"no picture", 20) == b"no picture"
    poor = recompress(scene(), 10)
    assert recompress(poor, 95) is poor


def test_without_any_library_pictures_stay_as_they_were(monkeypatch: pytest.MonkeyPatch) -> None:
    jpeg = scene()
    without(monkeypatch, "cv2", "PIL")
    assert recompress(jpeg, 20) is jpeg


class Library:
    """Makes pictures smaller when it is let."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.asked: list[bytes] = []
        self.may_go_on = threading.Semaphore(0)
        monkeypatch.setattr(recompress_module, "recompress", self.make)

    def make(self, jpeg: bytes, quality: int) -> bytes:
        self.asked.append(jpeg)
        assert self.may_go_on.acquire(timeout=60)
        if jpeg == b"damaged":
            raise ValueError("no picture")
        return b"smaller"


def picture(jpeg: bytes, taken_ns: int) -> Picture:
    return Picture(CapturedFrame(0, 0, 640, 480, jpeg), 0, taken_ns)


async def test_pictures_that_are_late_by_their_turn_are_not_made_smaller(monkeypatch: pytest.MonkeyPatch) -> None:
    library, made, now_ns = Library(monkeypatch), asyncio.Event(), 0
    recompressor = Recompressor(made.set, lambda: now_ns)
    first, newest = picture(b"first", 0), picture(b"newest", 100 * MAX_WAIT_NS)
    recompressor.begin(first, 20)
    for n in range(1, 100):
        recompressor.begin(picture(b"late", 0), n)
    now_ns = 100 * MAX_WAIT_NS
    recompressor.begin(newest, 20)
    library.may_go_on.release(101)
    async with asyncio.timeout(60):
        while newest.smaller.get(20) is None:
            made.clear()
            await made.wait()
    recompressor.close()
    assert library.asked == [b"first", b"newest"]
    assert first.smaller == newest.smaller == {20: b"smaller"}


async def test_what_waits_at_the_end_is_left_without_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    library, said, made = Library(monkeypatch), list[object](), asyncio.Event()
    asyncio.get_running_loop().set_exception_handler(lambda _, told: said.append(told))
    recompressor = Recompressor(made.set, lambda: 0)
    for jpeg in (b"first", b"second"):
        recompressor.begin(picture(jpeg, 0), 20)
    recompressor.close()
    library.may_go_on.release(2)
    async with asyncio.timeout(60):
        await made.wait()
    assert library.asked == [b"first"] and not said


async def test_a_station_has_one_picture_under_way_or_waiting(monkeypatch: pytest.MonkeyPatch) -> None:
    """However many the camera makes while one of them is made smaller."""
    library, made, now_ns = Library(monkeypatch), asyncio.Event(), 0
    recompressor = Recompressor(made.set, lambda: now_ns)
    slot = FrameSlot(recompressor.begin)
    stream = VideoStream(slot, LinkMeter())
    for n in range(1000):  # half a minute
        now_ns = n * 33_000_000
        slot.put(CapturedFrame(0, 0, 640, 480, bytes(70_000 + n)), now_ns)
        stream.next_frame(now_ns)
    library.may_go_on.release(1001)
    while (frame := stream.next_frame(now_ns)) is None:
        slot.put(CapturedFrame(0, 0, 640, 480, bytes(70_000 + 1000)), now_ns)
        made.clear()
        async with asyncio.timeout(60):
            await made.wait()
    recompressor.close()
    assert frame.jpeg == b"smaller" and len(library.asked) <= 3


async def test_a_library_that_fails_holds_up_no_other_picture(monkeypatch: pytest.MonkeyPatch) -> None:
    library, made = Library(monkeypatch), asyncio.Event()
    recompressor = Recompressor(made.set, lambda: 0)
    damaged, whole = picture(b"damaged", 0), picture(b"whole", 0)
    recompressor.begin(damaged, 20)
    recompressor.begin(whole, 20)
    library.may_go_on.release(2)
    async with asyncio.timeout(60):
        while whole.smaller.get(20) is None:
            made.clear()
            await made.wait()
    recompressor.close()
    assert damaged.smaller == {20: b"damaged"} and whole.smaller == {20: b"smaller"}
