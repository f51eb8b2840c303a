"""The current place as the robot comes, goes and is another one; with a localisation worker that tests answer for."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import station.robots.current_place
from shared.errors import DataError
from shared.messages import CameraFrame
from station.config import LocalizationConfig
from station.events import Events
from station.model.calibration_fit import judge
from station.model.frames import ImageFrame
from station.model.map_store import StoreAddress
from station.model.place_answer import HijackEvent, HijackNotice, PlaceAnswer, PlaceCandidate, PlaceReport
from station.robots.current_place import CurrentPlace
from station.workers.place_interface import PlaceProgram
from station.workers.request import Limit, Method, WorkerFailed
from tests.support.link import hello, until
from tests.support.made_up_workers import focal_fit


class FakeWorker:
    """Answers every picture with the kitchen, or as told."""

    made: list[FakeWorker]
    error: Exception | None = None
    answers: asyncio.Event

    def __init__(self, *_: object, limits: dict[Method, Limit], on_event: Callable[[object], None]) -> None:
        self.limits = limits
        self.tell = on_event
        self.calls: list[Method] = []
        self.made.append(self)

    async def start(self) -> None: ...

    async def close(self) -> None: ...

    def kill(self) -> None: ...

    def post(self, method: Method, *_: object) -> bool:
        self.calls.append(method)
        return True

    async def call(self, method: Method, *args: Any) -> PlaceReport | None:
        self.calls.append(method)
        if method is not PlaceProgram.answer:
            return None
        await self.answers.wait()
        if self.error is not None:
            raise self.error
        return kitchen(*args)


def kitchen(frame: ImageFrame) -> PlaceReport:
    t = frame.t_robot_ns
    place, other = PlaceCandidate("k", "Kitchen", 0.9), PlaceCandidate("h", "Hall", 0.1)
    answer = PlaceAnswer("known", place, 0.5, np.zeros(3), t, t, 3, 40, (other,), "seen")
    return PlaceReport("map", answer, np.eye(4), t, "found")


def picture(t_robot_ns: int) -> CameraFrame:
    return CameraFrame(seq=1, t_robot_ns=t_robot_ns, exposure_ns=0, width=1, height=1, skipped=0, jpeg=b"jpeg")


@pytest.fixture
async def place(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> AsyncIterator[CurrentPlace]:
    monkeypatch.setattr(station.robots.current_place, "Worker", FakeWorker)
    monkeypatch.setattr(FakeWorker, "made", [], raising=False)
    monkeypatch.setattr(FakeWorker, "answers", asyncio.Event(), raising=False)
    monkeypatch.setattr(FakeWorker, "error", None)
    FakeWorker.answers.set()
    place = CurrentPlace(StoreAddress(tmp_path), LocalizationConfig(rate_hz=30), Events())
    task = asyncio.create_task(place.run())
    place.on_connected(hello())
    await place.use_maps(("map",))
    yield place
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)


def last_state(place: CurrentPlace) -> str:
    """Of the time line."""
    return "" if place.visits.last is None else place.visits.last.state


def state_of(place: CurrentPlace) -> str:
    return "none" if place.report is None else place.report.answer.state


async def looking(place: CurrentPlace, t_robot_ns: int, condition: Callable[[], bool]) -> None:
    """Pictures of this time come until the condition is met."""

    def is_met() -> bool:
        if condition():
            return True
        place.on_frame(picture(t_robot_ns), 0)
        return False

    await until(is_met)


async def until_known(place: CurrentPlace, t_robot_ns: int) -> None:
    place.on_frame(picture(t_robot_ns), 0)
    await looking(place, t_robot_ns, lambda: state_of(place) == "known")


async def test_what_a_busy_worker_is_asked_may_wait_for_minutes_at_most(place: CurrentPlace) -> None:
    await until(lambda: bool(FakeWorker.made))
    backlog = {PlaceProgram.add_imu: 30_000, PlaceProgram.add_drive: 2400, PlaceProgram.add_pose: 300}
    assert FakeWorker.made[0].limits == {method: Limit(count) for method, count in backlog.items()}


async def test_without_a_robot_the_place_is_lost_and_says_why(place: CurrentPlace) -> None:
    place.on_disconnected("no map, no answer, nothing to lose")
    assert state_of(place) == "none"
    place.on_connected(hello())
    await until_known(place, 7)
    place.on_disconnected("the cable came off")
    report = place.report
    assert report is not None and report.answer.state == "lost" and "the cable came off" in report.answer.reason
    assert report.answer.place is None and report.answer.alternatives == () and report.answer.position_map is None
    assert last_state(place) == "lost"
    place.on_connected(hello())  # the same run: what was known comes back with the next picture
    assert state_of(place) == "lost"
    await until_known(place, 8)
    assert place.query_image(7) == b"jpeg"


async def test_an_answer_that_comes_after_the_robot_went_is_no_answer(place: CurrentPlace) -> None:
    await until_known(place, 7)
    FakeWorker.answers.clear()
    asked = FakeWorker.made[-1].calls.count(PlaceProgram.answer)
    await looking(place, 8, lambda: FakeWorker.made[-1].calls.count(PlaceProgram.answer) > asked)
    place.on_disconnected("the cable came off")
    answers = place.answers
    FakeWorker.answers.set()
    await until(lambda: place.answers > answers)
    assert state_of(place) == "lost" and last_state(place) == "lost"


def lifted(t_robot_ns: int) -> HijackNotice:
    before = kitchen(ImageFrame(1, t_robot_ns, 0, b"jpeg"))
    nowhere = replace(before.answer, state="lost", place=None, reason="hijacked (lifted)")
    event = HijackEvent(t_robot_ns, "imu", "lifted", 0.99)
    return HijackNotice(event, PlaceReport("map", nowhere, None, None, "lifted", num_hijacks=1))


async def test_whoever_is_told_of_a_hijack_is_not_told_the_old_place_any_more(place: CurrentPlace) -> None:
    await until_known(place, 7)
    FakeWorker.answers.clear()  # a busy machine: the next answer takes seconds
    FakeWorker.made[-1].tell(lifted(8))
    assert place._events.log[-1].text == "the robot was picked up: lifted"
    assert state_of(place) == "lost" and last_state(place) == "lost"


async def test_the_answer_to_a_picture_from_before_a_hijack_does_not_bring_the_old_place_back(
    place: CurrentPlace,
) -> None:
    await until_known(place, 7)
    FakeWorker.answers.clear()
    worker = FakeWorker.made[-1]
    asked = worker.calls.count(PlaceProgram.answer)
    await looking(place, 8, lambda: worker.calls.count(PlaceProgram.answer) > asked)
    FakeWorker.answers.set()  # the answer is there, and in the same moment the notice
    worker.tell(lifted(9))
    asked += 1
    await looking(place, 10, lambda: worker.calls.count(PlaceProgram.answer) > asked)
    assert state_of(place) == "lost"


async def test_an_answer_does_not_stay_true_by_itself(place: CurrentPlace, monkeypatch: pytest.MonkeyPatch) -> None:
    await until_known(place, 7)
    place.refresh()
    assert state_of(place) == "known"
    monkeypatch.setattr(station.robots.current_place, "OLD_AFTER_S", 0.0)
    monkeypatch.setattr(station.robots.current_place, "OLD_AFTER_PICTURES", 0)
    place.refresh()
    assert state_of(place) == "lost"
    assert place.report is not None and "is the camera working" in place.report.answer.reason


@pytest.mark.parametrize("other", [hello(session="two"), hello(robot="b")])
async def test_another_robot_or_run_begins_from_nothing(place: CurrentPlace, other: Any) -> None:
    await until_known(place, 7)
    FakeWorker.answers.clear()
    place.on_frame(picture(8), 0)
    worker = FakeWorker.made[-1]
    asked = worker.calls.count(PlaceProgram.answer)
    await looking(place, 8, lambda: worker.calls.count(PlaceProgram.answer) > asked)
    place.on_connected(other)
    assert state_of(place) == "none" and place.query_image(7) is None
    assert worker.calls[-1] is PlaceProgram.calibrate
    FakeWorker.answers.set()  # the answer about the old run's picture
    answers = place.answers
    await until_known(place, 9)
    assert place.answers == answers + 1 and place.query_image(8) is None


async def test_a_new_navigation_of_the_same_robot_forgets_no_fit_that_is_known(place: CurrentPlace) -> None:
    known = focal_fit(0.97)
    begun = judge((0.95, 0.05), np.zeros(3), np.full(3, 5.0), (0.0, 0.02))
    place.receive_fit(known)
    place.receive_fit(begun)
    assert place.calibration_fit == known
    place.on_connected(hello())  # the same run of the same robot
    assert place.calibration_fit == known
    place.on_connected(hello(robot="b"))
    place.receive_fit(begun)
    assert place.calibration_fit == begun


@pytest.mark.parametrize("error", [DataError("image 1 is not a readable JPEG"), WorkerFailed("answer failed")])
async def test_a_picture_that_cannot_be_looked_at_does_not_end_localisation(
    place: CurrentPlace, error: Exception
) -> None:
    await until_known(place, 7)
    monkey = FakeWorker.made[-1]
    monkey.error = error
    await looking(place, 8, lambda: str(error) in place.status)
    monkey.error = None
    answers = place.answers
    await looking(place, 9, lambda: place.answers > answers)
    assert place.status == "looking" and FakeWorker.made == [monkey]


async def test_a_map_that_cannot_be_read_is_given_up(place: CurrentPlace, monkeypatch: pytest.MonkeyPatch) -> None:
    async def broken(self: FakeWorker, *_: object) -> None:
        raise DataError("the map is broken")

    monkeypatch.setattr(FakeWorker, "call", broken)
    await place.use_maps(("other",))
    await looking(place, 7, lambda: place.status == "no localisation: the map is broken")
