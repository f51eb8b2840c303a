"""`station access …`: who is let in, and what is said to the person who decides it."""

from __future__ import annotations

import time
from pathlib import Path

import pytest
from typer.testing import CliRunner

from shared.errors import ConfigError
from shared.token_book import TokenBook
from station.access.visitors import access_folder
from station.commands.access import init, link
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
    assert len(str(refused.value)) < 300
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
