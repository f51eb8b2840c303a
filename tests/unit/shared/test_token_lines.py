"""The list of tokens as a person reads it."""

from __future__ import annotations

import json
import time
from pathlib import Path

import pytest

from shared.access import Role
from shared.token_book import TokenBook
from shared.token_lines import show_tokens

DAY_S = 86_400.0


@pytest.fixture
def book(tmp_path: Path) -> TokenBook:
    return TokenBook.create(tmp_path / "access")


def listed(book: TokenBook, capsys: pytest.CaptureFixture[str]) -> dict[str, str]:
    """The line of each name."""
    show_tokens(book, as_json=False)
    return {line.split("  ")[2]: line for line in capsys.readouterr().out.splitlines()}


def day(wall_s: float) -> str:
    return time.strftime("%Y-%m-%d %H:%M", time.localtime(wall_s))


def test_a_token_that_ends_by_itself_says_when(book: TokenBook, capsys: pytest.CaptureFixture[str]) -> None:
    now_s = time.time()
    book.add("anna", Role.DRIVE, now_s)
    book.add("guest", Role.WATCH, now_s, 2 * DAY_S)
    book.add("bert", Role.WATCH, now_s - 3 * DAY_S, DAY_S)
    lines = listed(book, capsys)
    assert " end" not in lines["anna"]
    assert lines["guest"].endswith(f"  ends {day(now_s + 2 * DAY_S)}")
    assert lines["bert"].endswith(f"  ended {day(now_s - 2 * DAY_S)}")
    show_tokens(book, as_json=True)
    expires = {token["name"]: token["expires"] for token in json.loads(capsys.readouterr().out)}
    assert expires == {"anna": None, "guest": now_s + 2 * DAY_S, "bert": now_s - 2 * DAY_S}


def test_a_revoked_token_says_only_that(book: TokenBook, capsys: pytest.CaptureFixture[str]) -> None:
    now_s = time.time()
    book.add("guest", Role.WATCH, now_s, 2 * DAY_S)
    book.revoke("guest", now_s)
    assert listed(book, capsys)["guest"].endswith(f"  revoked {day(now_s)}")


@pytest.mark.parametrize("wall_s", [-1e18, 1e308])
def test_a_time_that_no_calendar_has_is_shown_as_a_number(
    book: TokenBook, capsys: pytest.CaptureFixture[str], wall_s: float
) -> None:
    book.add("anna", Role.DRIVE, 100.0)
    book.path.write_text(book.path.read_text().replace("100.0", str(wall_s)))
    assert "which no calendar has" in listed(TokenBook(book.path.parent), capsys)["anna"]
