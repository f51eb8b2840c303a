"""`station access …`: who is let in, and what is said to the person who decides it."""

from __future__ import annotations

import time
from pathlib import Path

import pytest
from typer.testing import CliRunner

from shared.errors import ConfigError
from shared.token_book import TokenBook
from station.access.visitors import access_folder
from station.commands.access import add, init, link, revoke
from station.main import app as station_app


@pytest.fixture
def data(tmp_path: Path) -> Path:
    init(tmp_path)
    return tmp_path


def book(data: Path) -> TokenBook:
    return TokenBook(access_folder(data))


@pytest.mark.parametrize(
    "address",
    [
        "javascript:alert(1)",
        "192.168.1.20:8080",
        "ftp://station",
        "https://",
        "https://:8080",
        "https://station:80808",
        "https://[::1",
        "https://sta tion",
        "https://station\n/x",
        "https://station/\x1b[2J",
        "https://station/?page=1",
        "https://station/#map",
        f"https://{'a' * 5000}:x",
    ],
)
def test_a_link_to_no_page_is_refused_and_none_is_made(data: Path, address: str) -> None:
    before = book(data).path.read_bytes()
    with pytest.raises(ConfigError, match="--address") as refused:
        link("owner", address, data)
    assert len(str(refused.value)) < 400
    assert book(data).path.read_bytes() == before


@pytest.mark.parametrize(
    "address", ["https://192.168.1.20:8080", "http://proxy/station/", "https://[::1]:8080", "HTTPS://Station.local"]
)
def test_a_link_to_a_page_logs_in(data: Path, address: str, capsys: pytest.CaptureFixture[str]) -> None:
    link("owner", address, data)
    where, _, code = capsys.readouterr().out.strip().splitlines()[-1].partition("/#login=")
    assert where == address.rstrip("/")
    record = book(data).find(code, time.time())
    assert record is not None and record.kind == "link"


@pytest.mark.parametrize("days", ["inf", "nan", "1e300", "0", "-1", "36501"])
def test_a_token_that_shall_end_ends_within_a_century(data: Path, days: str) -> None:
    before = book(data).path.read_bytes()
    words = ["access", "add", "guest", "--role", "watch", "--data", str(data), "--days", days]
    assert CliRunner().invoke(station_app, words).exit_code == 2
    assert book(data).path.read_bytes() == before


@pytest.mark.parametrize("name", ["owner", "by id"])
def test_who_revokes_the_last_admin_is_told_how_to_make_one(
    data: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    add("anna", "drive", data)
    owner = next(token.id for token in book(data).tokens() if token.name == "owner")
    capsys.readouterr()
    revoke("owner" if name == "owner" else owner, data)
    said = capsys.readouterr()
    assert said.out == f"revoked {owner}  owner\n"
    assert said.err.count("\n") == 1
    assert f"`station access add NAME --role admin --data {data}`" in said.err


def test_who_sets_up_a_station_without_admin_again_is_told_how_to_make_one(
    data: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    add("anna", "drive", data)
    revoke("owner", data)
    capsys.readouterr()
    init(data)
    said = capsys.readouterr()
    assert said.out.startswith("certificate ") and "token" not in said.out
    assert f"`station access add NAME --role admin --data {data}`" in said.err


def test_nothing_is_said_of_admins_while_there_is_one(data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    add("anna", "drive", data)
    add("bert", "admin", data)
    revoke("anna", data)
    revoke("owner", data)
    init(data)
    assert capsys.readouterr().err == ""


def test_a_station_that_nobody_may_use_gets_an_admin_by_setting_it_up_again(
    data: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    revoke("owner", data)
    assert "`station access init --data" in capsys.readouterr().err
    init(data)
    said = capsys.readouterr()
    assert "token of owner (admin)" in said.out and said.err == ""
