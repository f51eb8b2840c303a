"""The station's configuration: read, checked, and the backend that it means for a robot."""

from __future__ import annotations

import json
from pathlib import Path

import msgspec
import pytest

from shared.calibration import REFERENCE_CAMERA, REFERENCE_ROBOT
from shared.errors import ConfigError
from station.config import (
    StationConfig,
    StoreConfig,
    check_backend,
    check_executor,
    check_folder,
    choose_backend,
    load_config,
    parse_address,
    parse_robot,
)


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


LONG = "n" * 100_000


@pytest.mark.parametrize(
    "content",
    [
        f'name = "{LONG}"',
        f"[api]\nport = {'9' * 4000}",
        f"[drive]\nlease_s = {'9' * 4000}",
        f"[recordings]\nkeep_free_mb = -{'9' * 4000}",
        f"{LONG} = 1",
        f"{LONG} = 1\n{LONG} = 1",
        f"[{LONG}]\n[{LONG}]",
        f'executor = "{LONG}"',
        f'[[robots]]\nname = "{LONG}"\nhost = "a"',
        f'[[robots]]\nname = "a"\nhost = "{LONG}"\n[[robots]]\nname = "b"\nhost = "{LONG}"',
    ],
    ids=lambda content: content.replace("n" * 1000, "").replace("9" * 100, "")[:30],
)
def test_what_is_wrong_is_not_repeated_whole(tmp_path: Path, content: str) -> None:
    path = tmp_path / "station.toml"
    path.write_text(content)
    with pytest.raises(ConfigError) as refused:
        load_config(path)
    assert len(str(refused.value)) < len(str(path)) + 600


@pytest.mark.parametrize("text", [LONG, f"{LONG}:{LONG}", f"{LONG}=a:1"], ids=["word", "address", "robot"])
def test_a_long_option_is_not_repeated_whole(text: str) -> None:
    for refuse in (check_backend, check_executor, lambda t: parse_robot(f"{t} ", "--robot")):
        with pytest.raises(ConfigError) as refused:
            refuse(text)
        assert len(str(refused.value)) < 800


@pytest.mark.parametrize(
    "value",
    [
        "true",
        "5",
        '["a"]',
        "1979-05-27",
        '""',
        '"a\\u0000b"',
        f'"/{"a" * 300}"',
        f'"{"/a" * 2500}"',
        '"~nobody-here/x"',
    ],
)
def test_a_data_folder_that_cannot_be_one_is_refused_in_one_short_sentence(tmp_path: Path, value: str) -> None:
    path = tmp_path / "station.toml"
    path.write_text(f"data_dir = {value}\n")
    with pytest.raises(ConfigError, match="data_dir") as refused:
        load_config(path)
    assert str(path) in str(refused.value) and len(str(refused.value)) < len(str(path)) + 400


def test_a_folder_is_one_or_may_become_one(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "folder").mkdir()
    for name in ("folder", "not-there", "not-there/below"):
        assert check_folder(tmp_path / name, "data_dir") == tmp_path / name
    for name in ("file", "file/below", "a" * 300, "a\0b"):
        with pytest.raises(ConfigError, match=r"^data_dir = .* is no folder"):
            check_folder(tmp_path / name, "data_dir")


@pytest.mark.parametrize(
    "url", ["sqlite://", "sqlite:///", "sqlite+pysqlite:///", "sqlite:///:memory:", f"sqlite:////{'a' * 5000}"]
)
def test_a_database_that_is_no_file_is_refused(url: str) -> None:
    with pytest.raises(ConfigError, match=r"store\.database") as refused:
        StoreConfig(url)
    assert len(str(refused.value)) < 400
    with pytest.raises(ConfigError, match="NUL"):
        StoreConfig("sqlite:////a\0b")


def test_a_database_file_or_server_is_taken() -> None:
    for url in ("", "sqlite:////var/lib/maps.db", "sqlite:///maps.db?timeout=3", "postgresql://u@h/maps"):
        assert StoreConfig(url).database == url


@pytest.mark.parametrize(
    ("text", "address"),
    [
        ("pi:7", ("pi", 7)),
        ("pi", ("pi", 7400)),
        ("[::1]:9", ("::1", 9)),
        ("[::1]", ("::1", 7400)),
        ("::1", ("::1", 7400)),
        ("[fe80::1%eth0]:7", ("fe80::1%eth0", 7)),
    ],
)
def test_addresses_are_read(text: str, address: tuple[str, int]) -> None:
    assert parse_address(text, "--robot") == address


@pytest.mark.parametrize(
    "text",
    [
        "",
        ":7",
        "pi:",
        "pi:0",
        "pi:70000",
        "pi:x",
        "[::1]:7400:3",
        "a:b:7",
        "[pi]:7",
        "[::1",
        "[::1]7",
        "pi\x1b[2J:7",
        "[fe80::1%\x1b]:7",
    ],
)
def test_wrong_addresses_are_refused(text: str) -> None:
    with pytest.raises(ConfigError, match="--robot"):
        parse_address(text, "--robot")


@pytest.mark.parametrize("name", ["", "x" * 65, "desk\nrobot lost", "\x1b[2J"])
def test_a_station_has_a_name_that_robots_take(tmp_path: Path, name: str) -> None:
    path = tmp_path / "station.toml"
    path.write_text(f"name = {json.dumps(name)}\n")
    with pytest.raises(ConfigError, match="name"):
        load_config(path)


def test_a_robot_on_wheels_with_an_imu_is_followed_by_the_filter_and_others_by_their_images() -> None:
    assert choose_backend("auto", REFERENCE_ROBOT) == "ukf"
    assert choose_backend("auto", msgspec.structs.replace(REFERENCE_ROBOT, imu=None)) == "sfm"
    assert choose_backend("auto", msgspec.structs.replace(REFERENCE_ROBOT, rig="hand-held")) == "sfm"
    guessed = msgspec.structs.replace(REFERENCE_CAMERA, is_measured=False)
    assert choose_backend("auto", msgspec.structs.replace(REFERENCE_ROBOT, camera=guessed)) == "sfm"
    assert choose_backend("ukf", msgspec.structs.replace(REFERENCE_ROBOT, camera=guessed)) == "ukf"
    assert choose_backend("sfm", REFERENCE_ROBOT) == "sfm"


def test_a_backend_that_does_not_exist_is_named_before_anything_starts() -> None:
    check_backend("sfm")
    check_backend("tests.support.made_up_workers:StraightSlam")
    for name in ("nonsense", "", "tests.support.made_up_workers:Nothing", "no_such_module:Slam", ":Slam"):
        with pytest.raises(ConfigError, match="choose one of auto, sfm, ukf, mono"):
            check_backend(name)
