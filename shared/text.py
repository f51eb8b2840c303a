"""Text from others, made harmless for the terminals, logs and pages that show it."""

from __future__ import annotations

import re

# Control characters (a terminal obeys them, a line break forges a line of a log), separators of lines and paragraphs,
# marks that turn the direction of all that follows, and halves of surrogate pairs, which no file can hold. What joins
# letters (U+200C, U+200D) is spelling in Persian and stays.
_UNPRINTABLE = r"\x00-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069\ud800-\udfff"
PRINTABLE = rf"^[^{_UNPRINTABLE}]*\Z"  # for names: others are refused
MAX_EXPLANATION = 300
_ONE = re.compile(f"[{_UNPRINTABLE}]")


def is_printable(text: str) -> bool:
    """Whether it can be shown and stored as it is."""
    return _ONE.search(text) is None


def printable(text: str) -> str:
    """With U+FFFD in the place of each character that cannot be shown, so that it is seen that there was one."""
    return _ONE.sub("\N{REPLACEMENT CHARACTER}", text)


def explain(error: Exception) -> str:
    """What a decoder complains of; it may quote what came, and names our pattern by its regular expression."""
    return printable(str(error).replace(f"matching regex {PRINTABLE!r}", "of printable characters")[:MAX_EXPLANATION])
