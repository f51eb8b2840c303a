"""Which robot is met at which address, and who stays paired when addresses go to others."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest
from typer.testing import CliRunner

from shared.access import Token
from shared.advice import complete
from shared.certificates import show_fingerprint
from shared.errors import ConfigError
from shared.private_files import write_private
from shared.text import is_printable
from station.access.paired_robots import PairedRobot, PairedRobots
from station.access.visitors import access_folder
from station.main import app

ANNA, BERTA, CARLA = (bytes([n] * 32) for n in (1, 2, 3))


def robot(name: str, host: str, fingerprint: bytes, robot_id: str = "") -> PairedRobot:
    return PairedRobot(
        robot_id=robot_id or name.lower(),
        name=name,
        host=host,
        port=7400,
        fingerprint=fingerprint.hex(),
        token=Token.new().text,
    )


@pytest.fixture
def robots(tmp_path: Path) -> PairedRobots:
    return PairedRobots(access_folder(tmp_path))


def is_taken(robots: PairedRobots, fingerprint: bytes, host: str) -> bool:
    return not isinstance(robots.recognise(fingerprint, host, 7400), str)


def test_a_new_robot_at_an_old_ones_address_does_not_unpair_it(robots: PairedRobots) -> None:
    berta = robot("Berta", "10.77.0.12", BERTA)
    robots.store(berta)
    assert is_taken(robots, BERTA, "10.77.0.14")  # the router gave it another address
    (before,) = robots.store(robot("Carla", "10.77.0.12", CARLA))
    assert before.name == "Berta"
    kept = next(one for one in robots.all() if one.name == "Berta")
    assert (kept.token, kept.host, kept.port, kept.also_at) == (berta.token, "10.77.0.14", 7400, ())
    assert is_taken(robots, BERTA, "10.77.0.14") and is_taken(robots, CARLA, "10.77.0.12")
    assert not is_taken(robots, BERTA, "10.77.0.12") and not is_taken(robots, CARLA, "10.77.0.14")


def test_a_robot_without_another_address_has_none_until_it_is_met_at_a_new_one(robots: PairedRobots) -> None:
    robots.store(robot("Berta", "10.77.0.12", BERTA))
    robots.store(robot("Carla", "10.77.0.12", CARLA))
    assert [(one.name, one.address) for one in robots.all()] == [("Berta", ""), ("Carla", "10.77.0.12:7400")]
    assert not isinstance(robots.recognise_anywhere(BERTA, "10.77.0.99", 7400), str)  # found by `auto`
    assert is_taken(robots, BERTA, "fd00::14")
    assert [(one.name, one.address) for one in robots.all()] == [
        ("Berta", "[fd00::14]:7400"),
        ("Carla", "10.77.0.12:7400"),
    ]
    assert not is_taken(robots, CARLA, "fd00::14")
    robots.store(robot("Anna", "fd00::14", ANNA))
    assert {one.name: one.address for one in robots.all()}["Berta"] == ""


def test_an_ipv6_address_that_was_given_later_becomes_the_one_where_it_is(robots: PairedRobots) -> None:
    robots.store(robot("Berta", "10.77.0.12", BERTA))
    assert is_taken(robots, BERTA, "fd00::14")
    robots.store(robot("Carla", "10.77.0.12", CARLA))
    assert {one.name: (one.host, one.port) for one in robots.all()}["Berta"] == ("fd00::14", 7400)


def test_two_that_swapped_addresses_need_one_code_and_never_answer_for_each_other(robots: PairedRobots) -> None:
    robots.store(robot("Anna", "10.77.0.11", ANNA))
    robots.store(robot("Berta", "10.77.0.12", BERTA))
    assert not is_taken(robots, ANNA, "10.77.0.12") and not is_taken(robots, BERTA, "10.77.0.11")
    robots.store(robot("Berta", "10.77.0.11", BERTA))  # as the sentence advises
    assert {one.name for one in robots.all()} == {"Anna", "Berta"}
    assert is_taken(robots, ANNA, "10.77.0.12") and is_taken(robots, BERTA, "10.77.0.11")
    assert not is_taken(robots, ANNA, "10.77.0.11") and not is_taken(robots, BERTA, "10.77.0.12")


def test_a_robot_that_was_set_up_anew_is_replaced(robots: PairedRobots) -> None:
    robots.store(robot("Anna", "10.77.0.11", ANNA))
    (before,) = robots.store(robot("Anna", "10.77.0.11", CARLA))
    assert before.fingerprint == ANNA.hex()
    assert [one.fingerprint for one in robots.all()] == [CARLA.hex()]


def test_pairing_again_says_nothing_of_itself_or_of_robots_elsewhere(robots: PairedRobots) -> None:
    assert robots.store(robot("Anna", "10.77.0.11", ANNA)) == ()
    assert robots.store(robot("Berta", "10.77.0.12", BERTA)) == ()
    assert robots.store(robot("Anna", "10.77.0.11", ANNA)) == ()


def test_a_fingerprint_that_is_none_is_a_sentence(robots: PairedRobots) -> None:
    robots.store(robot("Anna", "10.77.0.11", ANNA))
    for bad in ("xyz", "01", "", "zz" * 32):
        write_private(robots.path, msgspec.json.encode({"version": 1, "robots": [_raw(fingerprint=bad)]}))
        with pytest.raises(ConfigError, match=r"damaged .*of 64 hexadecimal digits.*fingerprint.*correct it"):
            robots.all()


def test_addresses_that_are_none_are_a_sentence_before_the_code_is_used_up(robots: PairedRobots) -> None:
    robots.store(robot("Berta", "10.77.0.12", BERTA))
    for host in ("10.77.0.14", "fd00::14", "fe80::14%eth0", "berta.local"):
        assert is_taken(robots, BERTA, host)  # and noted
    robots.check_writable()
    (berta,) = robots.all()
    damaged = msgspec.structs.replace(berta, also_at=("10.77.0.14:7400", "10.77.0.14:x"))
    write_private(robots.path, msgspec.json.encode({"version": 1, "robots": [damaged]}))
    with pytest.raises(ConfigError, match=r"damaged: in also_at of Berta '10\.77\.0\.14:x' is no HOST:PORT"):
        robots.check_writable()


@pytest.mark.parametrize("port", [0, -1, 65_536, 99_999_999])
def test_a_port_that_is_none_is_a_sentence(robots: PairedRobots, port: int) -> None:
    robots.store(robot("Anna", "10.77.0.11", ANNA))
    write_private(robots.path, msgspec.json.encode({"version": 1, "robots": [_raw(port=port)]}))
    with pytest.raises(ConfigError, match=r"damaged .*port.*correct it"):
        robots.all()


@pytest.mark.parametrize("content", [b"{}", b'{"a":1e999}', b'{"version":1}', b'{"version":2,"robots":[]}'])
def test_a_file_of_something_else_is_not_taken_for_one_without_robots(robots: PairedRobots, content: bytes) -> None:
    robots.store(robot("Anna", "10.77.0.11", ANNA))
    write_private(robots.path, content)
    with pytest.raises(ConfigError, match="is damaged"):
        robots.store(robot("Berta", "10.77.0.12", BERTA))
    assert robots.path.read_bytes() == content


def test_what_a_terminal_would_obey_is_not_shown(robots: PairedRobots) -> None:
    robots.check_writable()  # makes its folder
    raw = _raw(name="A\x1b[2J\u202eanna", host="h\x07", robot_id="\x1b")
    write_private(robots.path, msgspec.json.encode({"version": 1, "robots": [raw]}))
    shown = CliRunner().invoke(app, ["robots", "--data", str(robots.path.parent.parent)])
    assert shown.exit_code == 0 and is_printable(shown.output.rstrip("\n")) and "[2J" in shown.output


def test_of_two_robots_of_one_name_none_is_forgotten_until_the_certificate_says_which(robots: PairedRobots) -> None:
    robots.store(robot("Robot a", "10.77.0.11", ANNA, "a"))
    robots.store(robot("Robot a", "10.77.0.12", BERTA, "b"))
    with pytest.raises(
        ConfigError, match=r"2 paired robots are called 'Robot a': .*01:01:01:01.*02:02:02:02"
    ) as several:
        robots.forget("Robot a")
    assert "`station robots --forget 01:01:01:01`" in str(several.value) and len(robots.all()) == 2
    with pytest.raises(ConfigError, match="no paired robot"):
        robots.forget("02:")
    assert robots.forget("02:02:02:02").fingerprint == BERTA.hex()
    assert robots.forget("Robot a").fingerprint == ANNA.hex()
    assert robots.all() == ()


def test_a_robot_is_forgotten_by_its_whole_certificate_and_none_by_nothing(robots: PairedRobots) -> None:
    robots.store(robot("Berta", "10.77.0.12", BERTA))
    robots.store(robot("Carla", "10.77.0.12", CARLA))
    with pytest.raises(ConfigError, match="no paired robot"):
        robots.forget("")  # Berta has no address
    assert robots.forget(show_fingerprint(BERTA).upper()).name == "Berta"
    assert robots.forget("10.77.0.12").name == "Carla"


def test_a_file_without_robots_is_a_sentence_without_a_command_in_it(robots: PairedRobots, tmp_path: Path) -> None:
    robots.store(robot("Anna", "10.77.0.11", ANNA))
    write_private(robots.path, b"{}")
    shown = CliRunner().invoke(app, ["robots", "--data", str(tmp_path)])
    said = complete(str(shown.exception), "station", {"--data": tmp_path})
    assert "missing required field 'robots')" in said and "station robots" not in said


def _raw(**changes: object) -> dict[str, object]:
    return msgspec.to_builtins(robot("Anna", "10.77.0.11", ANNA)) | changes


def test_forgetting_a_robot_leaves_nothing_of_it_and_says_how_its_token_ends(
    robots: PairedRobots, tmp_path: Path
) -> None:
    anna, berta = robot("Anna", "10.77.0.11", ANNA), robot("Berta", "10.77.0.12", BERTA)
    robots.store(anna)
    robots.store(berta)
    shown = CliRunner().invoke(app, ["robots", "--data", str(tmp_path), "--forget", "Anna"])
    token = Token.parse(anna.token)
    assert shown.exit_code == 0 and token is not None
    assert f"`robot-server access revoke {token.id}`" in shown.stderr and "Anna" not in shown.stdout
    files = [path for path in tmp_path.rglob("*") if path.is_file()]
    assert robots.path in files and robots.path.stat().st_mode & 0o077 == 0
    content = b"".join(path.read_bytes() for path in files) + shown.output.encode()
    assert berta.token.encode() in content
    for left in (anna.token, anna.fingerprint):
        assert left.encode() not in content


@pytest.mark.parametrize("content", [b"", b"{", b"[]", 100_000 * b"[", b'{"version": 2}'])
def test_a_file_that_cannot_be_read_is_told_and_never_replaced(
    robots: PairedRobots, tmp_path: Path, content: bytes
) -> None:
    anna = robot("Anna", "10.77.0.11", ANNA)
    robots.store(anna)
    whole = robots.path.read_bytes()
    assert robots.damage == ""
    write_private(robots.path, content)
    for use in (robots.all, robots.check_writable, lambda: robots.store(anna), lambda: robots.forget("Anna")):
        with pytest.raises(ConfigError, match="is damaged"):
            use()
    assert str(robots.path) in robots.damage and "is damaged" in robots.damage
    shown = CliRunner().invoke(app, ["robots", "--data", str(tmp_path)])
    assert isinstance(shown.exception, ConfigError) and "is damaged" in str(shown.exception)
    assert robots.path.read_bytes() == content
    write_private(robots.path, whole)
    assert robots.all() == (anna,) and robots.damage == ""
