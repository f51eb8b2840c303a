"""Text from others, made harmless for the terminals, logs and pages that show it."""

from __future__ import annotations

import re
import unicodedata

# Control characters (a terminal obeys them, a line break forges a line of a log), separators of lines and paragraphs,
# marks that turn the direction of all that follows, and halves of surrogate pairs, which no file can hold. What joins
# letters (U+200C, U+200D) is spelling in Persian and stays.
_UNPRINTABLE = r"\x00-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069\ud800-\udfff"
PRINTABLE = rf"^[^{_UNPRINTABLE}]*\Z"  # for names: others are refused
# What leaves no mark and is no spelling (Default_Ignorable_Code_Point of Unicode without `_FORMS`, and blanks
# that count as signs): a name with it looks like another one, or like none.
_INVISIBLE = (
    r"\xad\u034f\u061c\u115f\u1160\u17b4\u17b5\u180b-\u180f\u200b\u200e\u200f\u2060-\u2065\u206a-\u206f\u2800\u3164\ufeff\uffa0"
    r"\ufff0-\ufffb\U0001bca0-\U0001bca3\U0001d173-\U0001d17a\U000e0000-\U000e00ff\U000e01f0-\U000e0fff"
)
SEEN_WHOLE = (
    rf"^[^{_UNPRINTABLE}{_INVISIBLE}]*\Z"  # for names that somebody chooses now; older ones are read as they are
)
# Joiners and variation selectors: they choose the form of the sign before them, in Persian, Japanese names and emoji.
_FORMS = re.compile(r"[\u200c\u200d\ufe00-\ufe0f\U000e0100-\U000e01ef]")
MAX_EXPLANATION = 300
_ONE = re.compile(f"[{_UNPRINTABLE}]")
_WHOLE = re.compile(SEEN_WHOLE)
_UNSEEN = re.compile(f"[{_INVISIBLE}]")


def is_printable(text: str) -> bool:
    """Whether it can be shown and stored as it is."""
    return _ONE.search(text) is None


def printable(text: str) -> str:
    """With U+FFFD in the place of each character that cannot be shown, so that it is seen that there was one."""
    return _ONE.sub("\N{REPLACEMENT CHARACTER}", text)


def is_seen_whole(text: str) -> bool:
    """Whether it can be shown, and each part of it is seen, so that a person can tell it from others and type it."""
    return _WHOLE.match(text) is not None and (not text or bool(look_of(text).strip()))


def is_unseen(text: str) -> bool:
    """Whether nothing of it is seen: blanks, and what leaves no mark."""
    return not look_of(without_invisible(text)).strip()


def look_of(text: str) -> str:
    """What is seen of it: two names with one look cannot be told apart."""
    return unicodedata.normalize("NFC", _FORMS.sub("", text))


def without_invisible(text: str) -> str:
    """Without what leaves no mark."""
    return _UNSEEN.sub("", text)


def columns(text: str) -> int:
    """As how many Latin letters it is wide: an ideogram is as two, what lies on the letter before as none."""
    return sum(map(_columns_of, text))


def fitted(text: str, width: int) -> str:
    """All of it where it is so many columns wide, else its beginning and an ellipsis."""
    if columns(text) <= width:
        return text
    kept, left = "", width - 1
    for letter in text:
        left -= _columns_of(letter)
        if left < 0:
            break
        kept += letter
    return f"{kept.rstrip()}…"


def _columns_of(letter: str) -> int:
    if unicodedata.category(letter) in ("Mn", "Me", "Cf"):
        return 0
    return 2 if unicodedata.east_asian_width(letter) in "WF" else 1


def explain(error: Exception) -> str:
    """What a decoder complains of; it may quote what came, and names our pattern by its regular expression."""
    said = str(error)
    for pattern, words in ((PRINTABLE, "of printable characters"), (SEEN_WHOLE, "of characters that can be seen")):
        said = said.replace(f"matching regex {pattern!r}", words)
    return printable(said[:MAX_EXPLANATION])
