"""A certificate that browsers will soon refuse is told in time: in the log, on the page, in `station access list`."""

from __future__ import annotations

import asyncio
import datetime
import math
from collections.abc import Callable

from shared.certificates import Identity, days_left

WARN_DAYS = 30
LOOK_S = 86_400.0


def expiry_sentence(identity: Identity | None, now: datetime.datetime) -> str:
    """What to do about the certificate, in a sentence; empty while there is nothing to do."""
    if identity is None:
        return ""
    try:
        left = days_left(identity, now)
    except (ImportError, OSError, ValueError):  # a station with a certificate from elsewhere may lack `cryptography`
        return ""
    if left > WARN_DAYS:
        return ""
    when = f"is good for {math.floor(left)} more days" if left > 0 else "has expired"
    return (
        f"the station's certificate {when}; run `station access init --renew`, start the station anew, and accept the"
        " new one in each browser"
    )


async def watch_expiry(identity: Identity | None, say: Callable[[str], None]) -> None:
    """Look now and once a day, until cancelled. The file is looked at, which may be a newer one than is served."""
    while identity is not None:
        if sentence := expiry_sentence(identity, datetime.datetime.now(datetime.UTC)):
            say(sentence)
        await asyncio.sleep(LOOK_S)
