"""A book of tokens as people and scripts read it: never a secret, never a digest."""

from __future__ import annotations

import datetime
import json
import time

from shared.errors import ConfigError
from shared.token_book import TokenBook, TokenRecord


def show_tokens(book: TokenBook, as_json: bool) -> None:
    """One line each, or JSON."""
    tokens = book.tokens()
    if as_json:
        print(json.dumps([describe(token) for token in tokens]))
        return
    now_s = time.time()
    for token in tokens:
        used = "never" if token.last_used_s is None else _date(token.last_used_s)
        state = "" if token.revoked_s is None else f"  revoked {_date(token.revoked_s)}"
        if token.expires_s is not None and token.revoked_s is None:
            state += f"  {'ends' if now_s < token.expires_s else 'ended'} {_date(token.expires_s)}"
        if token.confirm_by_s is not None:
            state += f"  ends {_date(token.confirm_by_s)} unless its station uses it"
        print(f"{token.id}  {token.role.value:5}  {token.name}  made {_date(token.created_s)}  used {used}{state}")
    if not tokens:
        print("nobody")


def revoke_token(book: TokenBook, name: str) -> None:
    """Raises ConfigError: nobody of this name."""
    ended = book.revoke(name, time.time())
    if not ended:
        raise ConfigError(f"nobody named {name!r} may; `access list` shows who may")
    for token in ended:
        print(f"revoked {token.id}  {token.name}")


def describe(token: TokenRecord) -> dict[str, str | float | None]:
    """What may be shown of a token: not its digest."""
    return {
        "id": token.id,
        "name": token.name,
        "role": token.role.value,
        "created": token.created_s,
        "last_used": token.last_used_s,
        "expires": token.expires_s,
        "revoked": token.revoked_s,
    }


def _date(wall_s: float) -> str:
    try:
        return datetime.datetime.fromtimestamp(wall_s).astimezone().strftime("%Y-%m-%d %H:%M")
    except (OSError, OverflowError, ValueError):  # a file that was changed by hand
        return f"at {wall_s:g} s, which no calendar has"
