"""The current place as the robot comes, goes and is another one; with a localisation worker that tests answer for."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import station.robots.places
from shared.errors import DataError
from shared.messages import CameraFrame
from station.config import LocalizationConfig
from station.events import Events
from station.maps.store import StoreAddress
from station.model.frames import ImageFrame
from station.model.place_answer import HijackEvent, HijackNotice, PlaceAnswer, PlaceCandidate, PlaceReport
from station.robots.places import Locating
from station.workers.worker import WorkerFailed
from tests.support.link import hello, until


class FakeWorker:
    """Answers every picture with the kitchen, or as told."""

    made: list[FakeWorker]
    error: Exception | None = None
    answers: asyncio.Event

    def __init__(self, *_: object, on_event: Callable[[object], None], **__: object) -> None:
        self.tell = on_event
        self.calls: list[str] = []
        self.made.append(self)

    async def start(self) -> None: ...

    async def close(self) -> None: ...

    def kill(self) -> None: ...

    def post(self, method: str, *_: object) -> bool:
        self.calls.append(method)
        return True

    async def call(self, method: str, *arguments: Any) -> Any:
        self.calls.append(method)
        if method != "answer":
            return None
        await self.answers.wait()
        if self.error is not None:
            raise self.error
        return kitchen(arguments[0])


def kitchen(frame: ImageFrame) -> PlaceReport:
    t = frame.t_robot_ns
    place, other = PlaceCandidate("k", "Kitchen", 0.9), PlaceCandidate("h", "Hall", 0.1)
    answer = PlaceAnswer("known", place, 0.5, np.zeros(3), t, t, 3, 40, (other,), "seen")
    return PlaceReport("map", answer, np.eye(4), t, "found")


def picture(t_robot_ns: int) -> CameraFrame:
    return CameraFrame(seq=1, t_robot_ns=t_robot_ns, exposure_ns=0, width=1, height=1, skipped=0, jpeg=b"jpeg")


@pytest.fixture
async def locating(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> AsyncIterator[Locating]:
    monkeypatch.setattr(station.robots.places, "Worker", FakeWorker)
    monkeypatch.setattr(FakeWorker, "made", [], raising=False)
    monkeypatch.setattr(FakeWorker, "answers", asyncio.Event(), raising=False)
    monkeypatch.setattr(FakeWorker, "error", None)
    FakeWorker.answers.set()
    locating = Locating(StoreAddress(tmp_path), LocalizationConfig(rate_hz=30), Events())
    task = asyncio.create_task(locating.run())
    locating.on_connected(hello())
    await locating.use(("map",))
    yield locating
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)


def state_of(locating: Locating) -> str:
    return "none" if locating.report is None else locating.report.answer.state


async def until_known(locating: Locating, t_robot_ns: int) -> None:
    def offered() -> bool:
        locating.offer(picture(t_robot_ns))
        return state_of(locating) == "known"

    await until(offered)


async def test_without_a_robot_the_place_is_lost_and_says_why(locating: Locating) -> None:
    locating.on_disconnected("no map, no answer, nothing to lose")
    assert state_of(locating) == "none"
    locating.on_connected(hello())
    await until_known(locating, 7)
    locating.on_disconnected("the cable came off")
    report = locating.report
    assert report is not None and report.answer.state == "lost" and "the cable came off" in report.answer.reason
    assert report.answer.place is None and report.answer.alternatives == () and report.answer.position_map is None
    assert locating.visits[-1].state == "lost"
    locating.on_connected(hello())  # the same run: what was known comes back with the next picture
    assert state_of(locating) == "lost"
    await until_known(locating, 8)
    assert locating.query_image(7) == b"jpeg"


async def test_an_answer_that_comes_after_the_robot_went_is_no_answer(locating: Locating) -> None:
    await until_known(locating, 7)
    FakeWorker.answers.clear()
    asked = FakeWorker.made[-1].calls.count("answer")
    await until(lambda: FakeWorker.made[-1].calls.count("answer") > asked or locating.offer(picture(8)))
    locating.on_disconnected("the cable came off")
    answers = locating.answers
    FakeWorker.answers.set()
    await until(lambda: locating.answers > answers)
    assert state_of(locating) == "lost" and locating.visits[-1].state == "lost"


def lifted(t_robot_ns: int) -> HijackNotice:
    before = kitchen(ImageFrame(1, t_robot_ns, 0, b"jpeg"))
    nowhere = replace(before.answer, state="lost", place=None, reason="hijacked (lifted)")
    event = HijackEvent(t_robot_ns, "imu", "lifted", 0.99)
    return HijackNotice(event, PlaceReport("map", nowhere, None, None, "lifted", num_hijacks=1))


async def test_whoever_is_told_of_a_hijack_is_not_told_the_old_place_any_more(locating: Locating) -> None:
    await until_known(locating, 7)
    FakeWorker.answers.clear()  # a busy machine: the next answer takes seconds
    FakeWorker.made[-1].tell(lifted(8))
    assert locating._events.log[-1].text == "the robot was picked up: lifted"
    assert state_of(locating) == "lost" and locating.visits[-1].state == "lost"


async def test_the_answer_to_a_picture_from_before_a_hijack_does_not_bring_the_old_place_back(
    locating: Locating,
) -> None:
    await until_known(locating, 7)
    FakeWorker.answers.clear()
    worker = FakeWorker.made[-1]
    asked = worker.calls.count("answer")
    await until(lambda: worker.calls.count("answer") > asked or locating.offer(picture(8)))
    FakeWorker.answers.set()  # the answer is there, and in the same moment the notice
    worker.tell(lifted(9))
    asked += 1
    await until(lambda: worker.calls.count("answer") > asked or locating.offer(picture(10)))
    assert state_of(locating) == "lost"


async def test_an_answer_does_not_stay_true_by_itself(locating: Locating, monkeypatch: pytest.MonkeyPatch) -> None:
    await until_known(locating, 7)
    locating.refresh()
    assert state_of(locating) == "known"
    monkeypatch.setattr(station.robots.places, "OLD_AFTER_S", 0.0)
    monkeypatch.setattr(station.robots.places, "OLD_AFTER_PICTURES", 0)
    locating.refresh()
    assert state_of(locating) == "lost"
    assert locating.report is not None and "is the camera working" in locating.report.answer.reason


@pytest.mark.parametrize("other", [hello(session="two"), hello(robot="b")])
async def test_another_robot_or_run_begins_from_nothing(locating: Locating, other: Any) -> None:
    await until_known(locating, 7)
    FakeWorker.answers.clear()
    locating.offer(picture(8))
    worker = FakeWorker.made[-1]
    asked = worker.calls.count("answer")
    await until(lambda: worker.calls.count("answer") > asked or locating.offer(picture(8)))
    locating.on_connected(other)
    assert state_of(locating) == "none" and locating.query_image(7) is None
    assert worker.calls[-1] == "calibrate"
    FakeWorker.answers.set()  # the answer about the old run's picture
    answers = locating.answers
    await until_known(locating, 9)
    assert locating.answers == answers + 1 and locating.query_image(8) is None


@pytest.mark.parametrize("error", [DataError("image 1 is not a readable JPEG"), WorkerFailed("answer failed")])
async def test_a_picture_that_cannot_be_looked_at_does_not_end_localisation(
    locating: Locating, error: Exception
) -> None:
    await until_known(locating, 7)
    monkey = FakeWorker.made[-1]
    monkey.error = error
    await until(lambda: locating.offer(picture(8)) or str(error) in locating.status)
    monkey.error = None
    answers = locating.answers
    await until(lambda: locating.offer(picture(9)) or locating.answers > answers)
    assert locating.status == "looking" and FakeWorker.made == [monkey]


async def test_a_map_that_cannot_be_read_is_given_up(locating: Locating, monkeypatch: pytest.MonkeyPatch) -> None:
    async def broken(self: FakeWorker, method: str, *_: Any) -> Any:
        raise DataError("the map is broken")

    monkeypatch.setattr(FakeWorker, "call", broken)
    await locating.use(("other",))
    await until(lambda: locating.offer(picture(7)) or locating.status == "no localisation: the map is broken")
