"""Drives and their SLAM process, with workers that tests let live, fail and die."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any

import pytest

import station.robots.slam
from shared.calibration import REFERENCE_ROBOT
from shared.errors import DataError, EstimationError
from shared.messages import CameraFrame, Hello
from station.config import SlamConfig
from station.errors import Conflict
from station.events import Events
from station.library.navigation_records import NavigationLibrary, NavigationRecord
from station.library.navigations import Navigations
from station.robots.current_navigation import CANCELLED, CurrentNavigation
from station.robots.navigation_files import NavigationRecorder
from station.robots.slam import MAX_DEATHS, SlamWorker
from station.workers.request import Limit, Method, WorkerDied
from station.workers.slam_interface import SlamProgram
from tests.support.link import Notes, hello, until


class FakeWorker:
    """A worker without a process. It begins when it may; `die` is what the operating system does to it."""

    made: list[FakeWorker]
    may_start: asyncio.Event

    def __init__(self, name: str, program: object, *, limits: Any, on_death: Any, on_failure: Any, **_: Any) -> None:
        self.limits: dict[Method, Limit] = limits
        self.on_death: Callable[[str], None] = on_death
        self.on_failure: Callable[[str], None] = on_failure
        self.dropped: dict[Method, int] = {}
        self.posted: list[Method] = []
        self.num_waiting = 0
        self.may_finish = asyncio.Event()
        self.may_finish.set()
        self.is_up = self.is_closed = self.is_dead = False
        self._begun: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self.made.append(self)

    def ask(self, method: Method, *_: object) -> asyncio.Future[Any]:
        return asyncio.ensure_future(self.finish()) if method is SlamProgram.finish else self._begun

    async def start(self) -> None:
        await self.may_start.wait()
        self.is_up = not self.is_closed and not self.is_dead
        if not self._begun.done():
            self._begun.set_result(None)

    def post(self, method: Method, *_: object) -> bool:
        self.posted.append(method)
        return not self.is_dead

    def waiting(self, method: Method) -> int:
        return self.num_waiting

    def kill(self) -> None:
        self.is_closed = True
        self.may_finish.set()

    async def finish(self) -> Any:
        await self.may_finish.wait()
        if self.is_dead or self.is_closed:
            raise WorkerDied("dead")
        raise EstimationError("drive longer")

    def die(self) -> None:
        self.is_up, self.is_dead = False, True
        if not self._begun.done():
            self._begun.set_exception(WorkerDied("dead"))
        self.on_death("the SLAM worker ended unexpectedly (exit code 7)")

    async def close(self) -> None:
        self.is_closed, self.is_up = True, False
        if not self._begun.done():
            self._begun.set_exception(WorkerDied("stopped"))


class FakeRecorder(Notes):
    """A recorder that knows whether it was closed."""

    error = ""
    is_closed = False

    def close(self) -> None:
        self.is_closed = True


class FullDisk(NavigationLibrary):
    """A library whose disk fills up, or is slow."""

    is_full = False

    def __init__(self, root: Path) -> None:
        super().__init__(root)
        self.may_write = threading.Event()
        self.may_write.set()
        self.written: list[str] = []  # states and names, in order

    def write(self, navigation: NavigationRecord) -> None:
        assert self.may_write.wait(60)
        if self.is_full:
            raise DataError("no space left")
        super().write(navigation)
        self.written.append(f"{navigation.state} {navigation.name}")


class Room:
    """Drives in a folder, and everything around them."""

    def __init__(self, folder: Path) -> None:
        self.library = FullDisk(folder)
        self.events = Events()
        self.recorder = FakeRecorder()
        self.navigations = Navigations(self.library, self.events)
        self.current = CurrentNavigation(self.navigations, SlamConfig(), self.events, self._record, lambda *_: None)
        self.cannot_record = ""

    def _record(self, path: Path) -> NavigationRecorder:
        path.parent.mkdir(parents=True, exist_ok=True)
        if self.cannot_record:
            raise DataError(self.cannot_record)
        return self.recorder

    def said(self, text: str) -> int:
        return sum(text in line.text for line in self.events.log)

    async def over(self, navigation_id: str) -> NavigationRecord:
        await until(lambda: self.library.get(navigation_id).state in ("ready", "failed"))
        return self.library.get(navigation_id)


@pytest.fixture
async def room(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[Room]:
    monkeypatch.setattr(station.robots.slam, "Worker", FakeWorker)
    monkeypatch.setattr(FakeWorker, "made", [], raising=False)
    monkeypatch.setattr(FakeWorker, "may_start", asyncio.Event(), raising=False)
    FakeWorker.may_start.set()
    made = Room(tmp_path / "navigations")
    yield made
    made.library.may_write.set()
    await made.navigations.close()


@pytest.mark.parametrize(("backend", "frames"), [("ukf", Limit(20, 5.0)), ("sfm", Limit(900, 30.0))])
async def test_a_live_backend_may_be_less_behind_than_one_that_answers_at_the_end(
    room: Room, backend: str, frames: Limit
) -> None:
    slam = SlamWorker("SLAM", SlamConfig(backend), REFERENCE_ROBOT, room.events, lambda _: None, lambda _: None)
    assert FakeWorker.made[0].limits == {
        SlamProgram.add_frame: frames,
        SlamProgram.add_imu: Limit(30_000),
        SlamProgram.add_drive: Limit(6000),
        SlamProgram.add_depth: Limit(60),
    }
    await slam.close()


async def test_a_drive_that_cannot_be_recorded_never_was(room: Room, tmp_path: Path) -> None:
    room.cannot_record = "cannot record there"
    with pytest.raises(DataError, match="cannot record there"):
        await room.current.start(hello(), "first")
    assert room.navigations.list() == [] and room.current.running is None and FakeWorker.made == []
    assert list((tmp_path / "navigations").iterdir()) == []
    room.cannot_record, room.library.is_full = "", True
    with pytest.raises(DataError, match="no space left"):
        await room.current.start(hello(), "second")
    assert room.navigations.list() == [] and room.recorder.is_closed and FakeWorker.made == []


async def test_what_is_left_to_do_after_a_drive_is_told_and_can_be_given_up(room: Room) -> None:
    navigation = await room.current.start(hello(), "Round the table")
    worker = FakeWorker.made[0]
    worker.may_finish.clear()
    for number in range(5):
        frame = CameraFrame(seq=number, t_robot_ns=number, exposure_ns=0, width=1, height=1, skipped=0, jpeg=b"")
        room.current.on_frame(frame, number)
    worker.num_waiting = 3
    await room.current.stop(navigation.id)
    assert room.navigations.get(navigation.id).message == "finishing: 2 of 5 pictures were looked at"
    worker.num_waiting = 0
    room.current.refresh()
    assert room.current.left_to_do == room.navigations.get(navigation.id).message == (
        "finishing: computing trajectory and landmarks"
    )  # fmt: skip
    with pytest.raises(Conflict, match="Round the table is being finished"):
        await room.navigations.rename(navigation.id, "Other")
    room.current.cancel(navigation.id)
    over = await room.over(navigation.id)
    assert over.state == "failed" and over.message == CANCELLED and room.current.left_to_do == ""
    with pytest.raises(Conflict, match="not being finished"):
        room.current.cancel(navigation.id)


async def test_a_recording_that_a_full_disk_ended_says_so_while_the_drive_goes_on(room: Room) -> None:
    navigation = await room.current.start(hello(), "")
    room.recorder.error = "recording ended: no space left"
    room.current.refresh()
    assert room.current.running is not None and room.current.running.message == room.recorder.error
    assert (await room.current.stop(navigation.id)).state == "finishing"
    assert room.recorder.error in (await room.over(navigation.id)).message


async def test_a_full_disk_at_the_end_of_a_drive_leaves_nothing_open(room: Room) -> None:
    navigation = await room.current.start(hello(), "")
    room.library.is_full = True
    assert (await room.current.stop(navigation.id)).state == "finishing"
    over = await room.over(navigation.id)
    assert over.message == "drive longer"
    assert room.recorder.is_closed and FakeWorker.made[0].is_closed
    assert room.said("no space left")
    await room.navigations.delete(navigation.id)  # it is not stuck


@pytest.mark.parametrize(
    ("other", "sentence"),
    [
        (hello(session="two"), "started anew"),
        (hello(robot="b"), "another robot"),
        (hello(robot="b", session="two"), "another robot"),
    ],
)
async def test_another_run_or_robot_ends_the_drive_and_keeps_its_recording(
    room: Room, other: Hello, sentence: str
) -> None:
    navigation = await room.current.start(hello(), "")
    room.current.on_connected(hello())  # the network was away for a moment
    assert room.current.running is not None
    room.current.on_connected(other)
    assert room.current.running is None
    over = await room.over(navigation.id)
    assert sentence in over.message and room.said(sentence)
    assert room.recorder.is_closed and [h.session_id for h in room.recorder.hellos] == ["one", "one"]
    assert (await room.current.start(other, "")).robot_id == other.robot_id
    await room.current.close()


async def test_every_death_of_slam_is_answered_by_another_process_up_to_a_limit(room: Room) -> None:
    navigation = await room.current.start(hello(), "")
    for deaths in range(1, MAX_DEATHS):
        await until(lambda: FakeWorker.made[-1].is_up)
        FakeWorker.made[-1].die()
        assert len(FakeWorker.made) == deaths + 1
    room.current.on_frame(CameraFrame(seq=1, t_robot_ns=1, exposure_ns=0, width=1, height=1, skipped=0, jpeg=b""), 1)
    assert FakeWorker.made[-1].posted == [SlamProgram.add_frame]
    FakeWorker.made[-1].die()
    assert len(FakeWorker.made) == MAX_DEATHS and room.said("goes on without it") == 1
    assert room.current.running is not None and not room.recorder.is_closed
    await room.current.stop(navigation.id)
    assert "goes on without it" in (await room.over(navigation.id)).message


@pytest.mark.parametrize("how", ["stop", "close"])
async def test_a_process_that_is_still_starting_is_closed_with_its_drive(room: Room, how: str) -> None:
    navigation = await room.current.start(hello(), "")
    await until(lambda: FakeWorker.made[0].is_up)
    FakeWorker.may_start.clear()
    FakeWorker.made[0].die()
    if how == "stop":
        await room.current.stop(navigation.id)
        FakeWorker.may_start.set()
        await room.over(navigation.id)
    else:
        asyncio.get_running_loop().call_soon(FakeWorker.may_start.set)
        await room.current.close()
    assert len(FakeWorker.made) == 2
    assert FakeWorker.made[1].is_closed and not FakeWorker.made[1].is_up
    assert not [task for task in asyncio.all_tasks() if "SLAM" in task.get_name()]


async def test_what_slam_refuses_is_told_once_and_counted(room: Room) -> None:
    navigation = await room.current.start(hello(), "")
    for sentence in ("image 1 is 3x3", "image 1 is 3x3", "image 2 is not a readable JPEG"):
        FakeWorker.made[0].on_failure(sentence)
    assert room.said("image 1 is 3x3") == 1 and room.said("image 2") == 1
    assert room.navigations.get(navigation.id).slam_failures == 3
    await room.current.stop(navigation.id)
    over = await room.over(navigation.id)
    assert over.slam_failures == 3 and "SLAM refused 3" in over.message and "image 1 is 3x3" in over.message


async def test_a_station_that_ends_at_once_after_a_drive_closes_it(room: Room) -> None:
    navigation = await room.current.start(hello(), "")
    await room.current.stop(navigation.id)
    await room.current.close()
    assert room.recorder.is_closed and FakeWorker.made[0].is_closed
    assert room.library.get(navigation.id).state == "failed"


async def test_a_station_that_ends_while_a_finished_navigation_is_put_away_keeps_what_came_of_it(
    room: Room, monkeypatch: pytest.MonkeyPatch
) -> None:
    may_close, is_closing = asyncio.Event(), asyncio.Event()
    close = FakeWorker.close

    async def close_slowly(worker: FakeWorker) -> None:
        is_closing.set()
        await may_close.wait()
        await close(worker)

    monkeypatch.setattr(FakeWorker, "close", close_slowly)
    navigation = await room.current.start(hello(), "")
    await room.current.stop(navigation.id)
    await asyncio.wait_for(is_closing.wait(), 60)
    ending = asyncio.create_task(room.current.close())
    await asyncio.sleep(0.05)
    may_close.set()
    await ending
    over = room.library.get(navigation.id)
    assert over.state == "failed" and "drive longer" in over.message
    assert room.library.written[-1].startswith("failed") and FakeWorker.made[0].is_closed


async def test_a_slow_disk_holds_up_nothing_and_gets_everything_in_order(room: Room) -> None:
    navigation = await room.current.start(hello(), "slow")
    room.library.may_write.clear()
    stopping = asyncio.create_task(room.current.stop(navigation.id))
    await until(lambda: room.navigations.get(navigation.id).state == "failed")  # SLAM has ended, all by the event loop
    assert not stopping.done(), "it was said to be kept"
    deleting = asyncio.create_task(room.navigations.delete(navigation.id))
    await asyncio.sleep(0)
    room.library.may_write.set()
    assert (await stopping).state == "finishing"
    await deleting
    assert room.library.written == ["recording slow", "finishing slow", "failed slow"]
    assert [gone.state for gone in room.library.deleted()] == ["failed"]
    again = NavigationLibrary(room.library.folder(navigation.id).parent)
    assert again.open() == [] and again.list() == []  # nothing came back behind the deletion


async def test_a_station_that_ends_has_written_everything(room: Room) -> None:
    navigation = await room.current.start(hello(), "")
    room.library.may_write.clear()
    closing = asyncio.create_task(room.current.close())
    await until(lambda: room.navigations.get(navigation.id).state == "failed")
    room.library.may_write.set()
    await closing
    await room.navigations.close()
    again = NavigationLibrary(room.library.folder(navigation.id).parent)
    assert again.open() == [] and again.get(navigation.id).message.startswith(
        "the station was stopped; the recording is kept"
    )


async def test_a_name_that_the_disk_does_not_take_is_refused(room: Room) -> None:
    navigation = await room.current.start(hello(), "first")
    await room.current.stop(navigation.id)
    await room.over(navigation.id)
    room.library.is_full = True
    with pytest.raises(DataError, match="no space left"):
        await room.navigations.rename(navigation.id, "second")
    assert room.navigations.get(navigation.id).name == "first"
    room.library.is_full = False
    assert (await room.navigations.rename(navigation.id, "second")).name == "second"


async def test_what_happens_while_a_drive_begins_on_a_slow_disk(room: Room, tmp_path: Path) -> None:
    room.library.may_write.clear()
    starting = asyncio.create_task(room.current.start(hello(), "first"))
    await until(lambda: room.current.is_busy)
    with pytest.raises(Conflict, match="just being begun"):
        await room.current.start(hello(), "second")
    room.current.on_connected(hello(session="two"))
    room.library.may_write.set()
    with pytest.raises(Conflict, match="start it again"):
        await starting
    assert not room.current.is_busy and room.recorder.is_closed and FakeWorker.made == []
    assert list((tmp_path / "navigations").iterdir()) == []
    room.library.may_write.clear()
    starting = asyncio.create_task(room.current.start(hello(session="two"), "third"))
    await until(lambda: room.current.is_busy)
    closing = asyncio.create_task(room.current.close())
    await asyncio.sleep(0)
    room.library.may_write.set()
    with pytest.raises(Conflict, match="ending"):
        await starting
    await closing
    assert list((tmp_path / "navigations").iterdir()) == [] and room.navigations.list() == []


async def test_what_is_over_is_not_said_to_be_cancelled(room: Room, tmp_path: Path) -> None:
    navigation = await room.current.start(hello(), "first")
    with pytest.raises(Conflict, match="not being finished"):
        room.current.cancel(navigation.id)
    room.library.may_write.clear()  # the disk does not know yet that it is over
    stopping = asyncio.create_task(room.current.stop(navigation.id))
    await until(lambda: room.navigations.get(navigation.id).state == "failed")
    with pytest.raises(Conflict, match=r"not being finished \(it is failed\)"):
        room.current.cancel(navigation.id)
    room.library.may_write.set()
    await stopping
    assert (await room.over(navigation.id)).message == "drive longer"
    slam = SlamWorker("SLAM", SlamConfig(), REFERENCE_ROBOT, room.events, lambda _: None, lambda _: None)
    with pytest.raises(EstimationError):
        await slam.finish(navigation.id, tmp_path)
    assert not slam.give_up()  # it has answered: its navigation may be there
    await slam.close()
