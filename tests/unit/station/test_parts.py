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

from shared.calibration import REFERENCE_CAMERA, REFERENCE_ROBOT
from shared.errors import ConfigError
from station.commands.serve import _settings as serve_settings
from station.config import (
    ApiConfig,
    SlamConfig,
    StationConfig,
    check_backend,
    choose_backend,
    load_config,
    parse_address,
)
from station.events import Latest, MessageHub
from station.library.navigation_records import NavigationLibrary, NavigationRecord
from station.model.frames import DriveSample, ImageFrame, ImuBatch
from station.model.points import pack_points
from station.motion.sensor_order import HOLD_BACK_NS, Sequencer
from station.robots.live_slam import PointBuffer

MS = 1_000_000


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
    library.store(NavigationRecord(id="nav-1", name="one", state="recording", started_wall_s=1.0, backend="sfm"))
    (tmp_path / "half").mkdir()
    (tmp_path / "half" / "record.json").write_text("{")
    again = NavigationLibrary(tmp_path)
    assert [d.id for d in again.open()] == ["nav-1"]
    assert again.get("nav-1").state == "failed"


def test_a_record_under_its_old_name_still_opens(tmp_path: Path) -> None:
    library = NavigationLibrary(tmp_path)
    library.store(NavigationRecord(id="nav-1", name="one", state="ready", started_wall_s=1.0, backend="sfm"))
    (tmp_path / "nav-1" / "record.json").rename(tmp_path / "nav-1" / "drive.json")
    again = NavigationLibrary(tmp_path)
    assert again.open() == []
    assert again.get("nav-1").name == "one"
    again.store(replace(again.get("nav-1"), name="two"))
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
