"""How a command tells whether a registration may be believed."""

from __future__ import annotations

from collections.abc import Sequence


def verdict(accepted: bool, reasons: Sequence[str]) -> str:
    """For a person to read: a reason per line where there are several."""
    word = "accepted" if accepted else "refused"
    return f"{word}: {reasons[0]}" if len(reasons) == 1 else "\n  ".join([f"{word}:", *reasons])
