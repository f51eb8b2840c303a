"""Parts of the running station that need neither socket nor process."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import station.workers.worker
from shared.calibration import REFERENCE_CAMERA, REFERENCE_ROBOT
from shared.errors import ConfigError
from shared.messages import MAX_DRIVE_TTL_MS, Capabilities
from station.commands.serve import _settings as serve_settings
from station.config import ApiConfig, DriveConfig, SlamConfig, StationConfig, choose_backend, load_config, parse_address
from station.errors import Conflict, NotDriver, OutOfRange
from station.events import Latest, MessageHub
from station.library.navigation_records import NavigationLibrary, NavigationRecord
from station.model.frames import DriveSample, ImageFrame, ImuBatch
from station.model.points import pack_points
from station.motion.sensor_order import HOLD_BACK_NS, Sequencer
from station.robots.driving import DriverLease, Driving
from station.robots.live_slam import PointBuffer
from station.slam.backends import check_backend
from station.workers.worker import Outbox, Worker, WorkerDied, WorkerFailed

MS = 1_000_000


def test_lease_goes_to_the_first_who_speaks_and_ends_with_silence() -> None:
    lease = DriverLease(1000 * MS)
    assert lease.claim("anna", 0) and not lease.claim("ben", 500 * MS)
    assert lease.claim("anna", 900 * MS)  # speaking keeps it
    assert lease.driver(1800 * MS) == "anna" and lease.driver(1900 * MS) is None
    assert lease.claim("ben", 1900 * MS) and lease.driver(1900 * MS) == "ben"


def test_lease_can_be_taken_over_and_released() -> None:
    lease = DriverLease(1000 * MS)
    lease.claim("anna", 0)
    lease.take_over("ben", 1)
    assert lease.driver(2) == "ben" and not lease.claim("anna", 2)
    lease.release("anna")  # not hers any more
    assert lease.driver(3) == "ben"
    lease.release("ben")
    assert lease.driver(4) is None


def test_who_takes_over_has_time_for_the_first_command_and_keeps_the_wheel_by_commands() -> None:
    clock = [0]
    desk = driving(Link(), clock)
    desk.drive("anna", 0.1, 0.0, 200)
    desk.take_over("ben")
    clock[0] = 4900 * MS
    assert desk.driver == "ben" and desk.keeps_wheel_s == pytest.approx(1.1)
    for _ in range(10):  # once a second, as long as a command may hold
        desk.drive("ben", 0.1, 0.0, 1000)
        clock[0] += 1000 * MS
        with pytest.raises(NotDriver, match="ben drives"):
            desk.drive("anna", 0.1, 0.0, 200)
    clock[0] += 1000 * MS
    assert desk.driver is None
    desk.drive("anna", 0.1, 0.0, 200)
    assert desk.driver == "anna"


def test_taking_over_for_good_is_not_possible() -> None:
    clock = [0]
    desk = driving(Link(), clock)
    desk.take_over("ben")
    clock[0] = 6000 * MS
    assert desk.driver is None


class Link:
    """Keeps what it was told."""

    def __init__(self) -> None:
        self.told: list[tuple[float, float, int] | str] = []

    def drive(self, linear: float, angular: float, ttl_ms: int) -> bool:
        self.told.append((linear, angular, ttl_ms))
        return True

    def stop(self) -> bool:
        self.told.append("stop")
        return True

    def point(self, pan: float, tilt: float) -> bool:
        return True


def driving(link: Link, clock: list[int]) -> Driving:
    able = Capabilities(camera=True, imu=True, drive=True, pan_tilt=True, battery=False, hijack=False)
    return Driving(link, DriveConfig(), lambda: able, lambda _: None, lambda _: None, now_ns=lambda: clock[0])


def test_a_take_over_stops_the_robot_and_the_same_driver_does_not() -> None:
    link, clock = Link(), [0]
    desk = driving(link, clock)
    desk.drive("anna", 0.1, 0.0, 200)
    desk.take_over("anna")
    assert link.told == [(0.1, 0.0, 200)]
    desk.take_over("ben")
    assert link.told[-1] == "stop"
    with pytest.raises(NotDriver, match="ben drives"):
        desk.drive("anna", 0.1, 0.0, 200)


def test_a_stop_by_somebody_else_holds_until_the_driver_lets_go() -> None:
    link, clock = Link(), [0]
    desk = driving(link, clock)
    desk.drive("anna", 0.1, 0.0, 1000)
    clock[0] = 590 * MS  # a long command: she has been silent, but not since the stop
    desk.stop("ben")
    for _ in range(100):  # she holds on
        clock[0] += 30 * MS
        with pytest.raises(Conflict, match="let go of the joystick once"):
            desk.drive("anna", 0.1, 0.0, 200)
    assert link.told[-1] == "stop" and desk.driver == "anna" and not desk.is_moving
    clock[0] += 700 * MS
    desk.drive("anna", 0.1, 0.0, 200)
    assert link.told[-1] == (0.1, 0.0, 200)


def test_a_stop_holds_against_a_program_that_repeats_once_a_second() -> None:
    link, clock = Link(), [0]
    desk = driving(link, clock)
    desk.drive("program", 0.1, 0.0, 1000)
    desk.stop("ben")
    for _ in range(10):
        clock[0] += 1000 * MS
        with pytest.raises(Conflict, match="let go of the joystick once"):
            desk.drive("program", 0.1, 0.0, 1000)
    assert link.told == [(0.1, 0.0, MAX_DRIVE_TTL_MS), "stop"]
    clock[0] += 1500 * MS  # silent half a second after its last command would have ended
    desk.drive("program", 0.1, 0.0, 1000)
    assert len(link.told) == 3


def test_a_recorder_that_fails_does_not_keep_the_robot_from_stopping() -> None:
    def fail(*_: object) -> None:
        raise OSError("disk full")

    link = Link()
    desk = Driving(link, DriveConfig(), lambda: None, lambda _: None, lambda _: None, on_command=fail)
    with pytest.raises(OSError, match="disk full"):
        desk.stop("anna")
    assert link.told == ["stop"]


@pytest.mark.parametrize("lets_go", ["zero", "stop", "release"])
def test_zero_stop_and_release_are_letting_go(lets_go: str) -> None:
    link, clock = Link(), [0]
    desk = driving(link, clock)
    desk.drive("anna", 0.1, 0.0, 200)
    desk.stop(None)
    with pytest.raises(Conflict):
        desk.drive("anna", 0.1, 0.0, 200)
    {"zero": lambda: desk.drive("anna", 0.0, 0.0, 200), "stop": lambda: desk.stop("anna")}.get(
        lets_go, lambda: desk.release("anna")
    )()
    desk.drive("anna", 0.1, 0.0, 200)
    assert link.told[-1] == (0.1, 0.0, 200)


def test_a_drivers_own_stop_holds_nobody() -> None:
    link = Link()
    desk = driving(link, [0])
    desk.drive("anna", 0.1, 0.0, 200)
    desk.stop("anna")
    desk.drive("anna", 0.1, 0.0, 200)
    desk.take_over("ben")
    desk.drive("ben", 0.2, 0.0, 200)
    assert link.told == [(0.1, 0.0, 200), "stop", (0.1, 0.0, 200), "stop", (0.2, 0.0, 200)]


@pytest.mark.parametrize(
    ("linear", "angular", "ttl_ms"),
    [(0.6, 0, 200), (0, 2.5, 200), (float("nan"), 0, 200), (0, float("inf"), 200), (0, 0, 0), (0, 0, 1001)],
)
def test_commands_out_of_range_are_refused_and_do_not_take_the_wheel(
    linear: float, angular: float, ttl_ms: int
) -> None:
    link = Link()
    desk = driving(link, [0])
    with pytest.raises(OutOfRange):
        desk.drive("anna", linear, angular, ttl_ms)
    assert desk.driver is None and link.told == []


async def test_outbox_drops_the_oldest_of_a_full_kind_only() -> None:
    outbox = Outbox({"frame": 2})
    for n in range(4):
        outbox.put("frame", (n,))
        outbox.put("imu", (10 + n,))
    assert [await outbox.take() for _ in range(6)] == [(10,), (11,), (2,), (12,), (3,), (13,)]
    assert outbox.dropped["frame"] == 2 and outbox.dropped["imu"] == 0
    outbox.close()
    assert await outbox.take() is None


async def test_an_outbox_nobody_gave_a_limit_has_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(station.workers.worker, "MAX_WAITING", 2)
    outbox = Outbox({})
    assert [outbox.put("add_drive", (n,)) for n in range(3)] == [True, True, False]
    assert outbox.dropped["add_drive"] == 1 and await outbox.take() == (1,)


async def test_a_worker_refuses_calls_beyond_what_can_wait(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(station.workers.worker, "MAX_CALLS", 1)
    worker = Worker("test", "tests.support.made_up_workers:Nobody")
    waiting = worker.ask("first")
    with pytest.raises(WorkerFailed, match="1 calls wait"):
        await worker.call("second")
    await worker.close()  # never started: nothing to wait for
    with pytest.raises(WorkerDied):
        await waiting


@given(
    frames=st.lists(st.integers(0, 2000), unique=True, min_size=1, max_size=30).map(sorted),
    batch_ms=st.integers(5, 40),
    shift_ms=st.integers(-50, 50),
    late=st.lists(st.integers(0, 3), min_size=30, max_size=30),
)
def test_sequencer_gives_everything_in_sensor_time_order(
    frames: list[int], batch_ms: int, shift_ms: int, late: list[int]
) -> None:
    sequencer = Sequencer(shift_ms / 1e3, has_imu=True)
    out: list[ImuBatch | DriveSample | ImageFrame] = []
    waiting = list(frames)
    for start in range(0, 2200, batch_ms):
        while waiting and waiting[0] <= start - late[len(waiting) % 30]:
            sequencer.add_frame(ImageFrame(0, waiting.pop(0) * MS, 0, b""))
            out += sequencer.ready()
        t = np.arange(start, start + batch_ms, 5, dtype=np.int64) * MS
        sequencer.add_imu(ImuBatch(t, np.zeros((len(t), 3)), np.zeros((len(t), 3))))
        out += sequencer.ready()
    out += sequencer.rest()
    times = [np.array([i.t_robot_ns + shift_ms * MS]) if isinstance(i, ImageFrame) else i.t_robot_ns for i in out]
    merged = np.concatenate([np.atleast_1d(t) for t in times])
    assert (np.diff(merged) >= 0).all()
    assert [i.t_robot_ns // MS for i in out if isinstance(i, ImageFrame)] == frames
    samples = sum(len(i) for i in out if isinstance(i, ImuBatch))
    assert samples == sum(len(range(s, s + batch_ms, 5)) for s in range(0, 2200, batch_ms))


def test_frames_go_on_without_imu_when_it_is_silent() -> None:
    sequencer = Sequencer(0.0, has_imu=True)
    for n in range(100):
        sequencer.add_frame(ImageFrame(n, n * 33 * MS, 0, b""))
    assert len(list(sequencer.ready())) >= 30
    without = Sequencer(0.0, has_imu=False)
    without.add_frame(ImageFrame(0, 0, 0, b""))
    assert list(without.ready()) == []
    without.add_frame(ImageFrame(1, HOLD_BACK_NS, 0, b""))
    assert len(list(without.ready())) == 1


async def test_latest_gives_the_newest_and_counts_the_others() -> None:
    box: Latest[int] = Latest()
    for n in range(3):
        box.put(n)
    assert await box.get() == 2 and box.skipped == 2


async def test_a_new_reader_gets_the_state_and_a_slow_one_only_the_newest() -> None:
    hub: MessageHub[str] = MessageHub()
    hub.put("old", "robot")
    hub.put("new", "robot")
    with hub.subscribe() as reader:
        assert await reader.get() == "new"
        for n in range(1000):
            hub.put(f"pose {n}", "pose")
            hub.put(f"line {n}")
        lines = [await reader.get() for _ in range(256)]
        assert lines[-1] == "line 999" and reader.lost == 1000 - 256
        assert await reader.get() == "pose 999"
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(0.01):
                await reader.get()
    assert hub.num_readers == 0


@given(counts=st.lists(st.integers(0, 3000), max_size=6))
def test_point_buffer_keeps_all_points_in_order(counts: list[int]) -> None:
    buffer, total = PointBuffer(), 0
    for count in counts:
        p = np.arange(total, total + count, dtype=np.float32)[:, None].repeat(3, axis=1)
        buffer.add(p, np.full((count, 3), 7, np.uint8))
        total += count
    p, rgb = buffer.since(0)
    assert len(buffer) == total == len(p) and (p[:, 0] == np.arange(total)).all() and (rgb == 7).all()
    assert len(buffer.since(total)[0]) == 0


def test_points_are_packed_in_sixteen_bytes() -> None:
    packed = pack_points(np.array([[1.0, 2.0, 3.0]]), np.array([[4, 5, 6]], np.uint8), np.array([9], np.uint8))
    assert packed == np.array([1, 2, 3], "<f4").tobytes() + bytes([4, 5, 6, 9])


def test_config_file_is_read_and_unknown_keys_are_named(tmp_path: Path) -> None:
    path = tmp_path / "station.toml"
    path.write_text('data_dir = "/tmp/x"\n[robot]\nhost = "pi"\n[slam]\nbackend = "ukf"\n')
    config = load_config(path)
    assert (config.robot.host, config.slam.backend, config.data_dir) == ("pi", "ukf", Path("/tmp/x"))
    assert load_config(None) == StationConfig()
    path.write_text("[slam]\nbackened = 'ukf'\n")
    with pytest.raises(ConfigError, match=r"slam\.backened"):
        load_config(path)
    path.write_text("[api]\nport = 'many'\n")
    with pytest.raises(ConfigError, match="port"):
        load_config(path)
    path.write_text("[drive]\nlease_s = 0\n")
    with pytest.raises(ConfigError, match="lease_s"):
        load_config(path)


@pytest.mark.parametrize(
    ("text", "address"), [("pi:7", ("pi", 7)), ("pi", ("pi", 7400)), ("[::1]:9", ("::1", 9)), ("[::1]", ("::1", 7400))]
)
def test_addresses_are_read(text: str, address: tuple[str, int]) -> None:
    assert parse_address(text, "--robot") == address


def test_a_robot_on_wheels_with_an_imu_is_followed_by_the_filter_and_others_by_their_images() -> None:
    assert choose_backend("auto", REFERENCE_ROBOT) == "ukf"
    assert choose_backend("auto", msgspec.structs.replace(REFERENCE_ROBOT, imu=None)) == "sfm"
    assert choose_backend("auto", msgspec.structs.replace(REFERENCE_ROBOT, robot_kind="generic")) == "sfm"
    guessed = msgspec.structs.replace(REFERENCE_CAMERA, is_measured=False)
    assert choose_backend("auto", msgspec.structs.replace(REFERENCE_ROBOT, camera=guessed)) == "sfm"
    assert choose_backend("ukf", msgspec.structs.replace(REFERENCE_ROBOT, camera=guessed)) == "ukf"
    assert choose_backend("sfm", REFERENCE_ROBOT) == "sfm"


def test_a_backend_that_does_not_exist_is_named_before_anything_starts() -> None:
    check_backend("sfm")
    check_backend("tests.support.made_up_workers:StraightSlam")
    for name in ("nonsense", "", "tests.support.made_up_workers:Nothing", "no_such_module:Slam", ":Slam"):
        with pytest.raises(ConfigError, match="choose one of auto, sfm, ukf"):
            check_backend(name)
        with pytest.raises(ConfigError, match="choose one of auto, sfm, ukf"):
            serve_settings(StationConfig(slam=SlamConfig(backend=name)), None, None, None, None, None, False)


def test_options_of_serve_keep_what_the_file_says_beside_them() -> None:
    config = StationConfig(api=ApiConfig(host="0.0.0.0", allowed_hosts=("robots.local",)))
    settings = serve_settings(config, ["pi:7"], None, 9000, None, "ukf", False)
    assert settings.api == ApiConfig("0.0.0.0", 9000, ("robots.local",))
    assert (settings.slam.backend, settings.fleet[0].host) == ("ukf", "pi")


@pytest.mark.parametrize("text", ["", ":7", "pi:", "pi:0", "pi:70000", "pi:x"])
def test_wrong_addresses_are_refused(text: str) -> None:
    with pytest.raises(ConfigError, match="--robot"):
        parse_address(text, "--robot")


def test_a_drive_that_a_dead_station_left_is_kept_as_failed(tmp_path: Path) -> None:
    library = NavigationLibrary(tmp_path)
    assert library.open() == []
    library.keep(NavigationRecord(id="nav-1", name="one", state="recording", started_wall_s=1.0, backend="sfm"))
    (tmp_path / "half").mkdir()
    (tmp_path / "half" / "record.json").write_text("{")
    again = NavigationLibrary(tmp_path)
    assert [d.id for d in again.open()] == ["nav-1"]
    assert again.get("nav-1").state == "failed"


def test_a_record_under_its_old_name_still_opens(tmp_path: Path) -> None:
    library = NavigationLibrary(tmp_path)
    library.keep(NavigationRecord(id="nav-1", name="one", state="ready", started_wall_s=1.0, backend="sfm"))
    (tmp_path / "nav-1" / "record.json").rename(tmp_path / "nav-1" / "drive.json")
    again = NavigationLibrary(tmp_path)
    assert again.open() == []
    assert again.get("nav-1").name == "one"
    again.keep(replace(again.get("nav-1"), name="two"))
    assert [path.name for path in (tmp_path / "nav-1").iterdir()] == ["record.json"]
    reopened = NavigationLibrary(tmp_path)
    reopened.open()
    assert reopened.get("nav-1").name == "two"


def test_a_drive_whose_record_is_lost_is_known_by_its_recording(tmp_path: Path) -> None:
    for name in ("nav-a", "nav-b", ".bin"):
        (tmp_path / name).mkdir()
    (tmp_path / "nav-a" / "recording.mcap").write_bytes(b"x")
    (tmp_path / "nav-a" / "record.json").write_text('{"id": "nav-a", "na')
    interrupted = NavigationLibrary(tmp_path).open()
    assert [(drive.id, drive.state) for drive in interrupted] == [("nav-a", "failed")]
    assert [drive.id for drive in NavigationLibrary(tmp_path).open()] == []  # it has a record again
