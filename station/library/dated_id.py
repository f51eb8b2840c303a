"""Ids that a person can read: from the clock on the wall."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable


def free_dated_id(kind: str, is_taken: Callable[[str], bool]) -> str:
    """`nav-20261122-190501`, or with `-2`, `-3`, … behind it where that is taken."""
    stem = time.strftime(f"{kind}-%Y%m%d-%H%M%S", time.localtime())
    numbered = (f"{stem}-{number}" for number in itertools.count(2))
    return next(candidate for candidate in itertools.chain([stem], numbered) if not is_taken(candidate))
