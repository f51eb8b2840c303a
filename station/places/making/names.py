"""Names of places that no person named."""

from __future__ import annotations

NAME_PREFIX = "Place "


def has_own_name(name: str) -> bool:
    """Whether a person named the place, not its clustering."""
    return not (name.startswith(NAME_PREFIX) and name.removeprefix(NAME_PREFIX).isdecimal())
