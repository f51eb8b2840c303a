"""The words for rooms: how they are written, and what a model calls what they look like. A TOML file, for editing."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import msgspec

from shared.bounded import parse_toml, read_text
from shared.errors import DataError
from shared.text import is_printable

DEFAULT = Path(__file__).with_suffix(".toml")
MAX_FILE_BYTES, MAX_ROOMS = 1_000_000, 1000
MAX_NAME, MAX_PHRASE = 80, 300  # characters: of a room's name in a map, and what CLIP's 77 tokens hold at most
_NUMBER = re.compile(r"[\s.#-]*\d[\d./-]*$")


def _folded(text: str) -> str:
    """Without upper case and accents, which a reader of printed words gets wrong."""
    apart = unicodedata.normalize("NFKD", text.casefold())
    return "".join(c for c in apart if not unicodedata.combining(c))


class RoomWord(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One kind of room."""

    name: str
    written: tuple[str, ...] = ()
    looks_like: tuple[str, ...] = ()


class Nothing(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What views look like that show no room."""

    looks_like: tuple[str, ...] = ()


class RoomWords(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """All kinds of rooms that are looked for."""

    rooms: tuple[RoomWord, ...]
    nothing: Nothing = Nothing()

    def number_of(self, text: str) -> int | None:
        """Which of `rooms` a text names, as "KITCHEN" or "Bedroom 2" do; None: none of them."""
        found = self._found(text)
        return None if found is None else found[0]

    def spelled(self, text: str) -> str | None:
        """A text that names a room in the list's own spelling, as "Küche 2" for "KUCHE 2"; None: it names none."""
        found = self._found(text)
        return None if found is None else found[1]

    def _found(self, text: str) -> tuple[int, str] | None:
        word = _NUMBER.sub("", text)
        for alike in (str.casefold, _folded):  # "Salon" and "Salón" are two
            spellings = {alike(s): (n, s) for n, room in enumerate(self.rooms) for s in (*room.written, room.name)}
            for part in (text, word):
                if (found := spellings.get(alike(part))) is not None:
                    return found[0], found[1] + text[len(part) :]
        return None


@cache
def default_words() -> RoomWords:
    """The list that comes with the program."""
    return load_room_words(DEFAULT)


def load_room_words(path: Path) -> RoomWords:
    """Raises DataError, naming the file and what is wrong with it."""
    try:
        content = parse_toml(read_text(path, MAX_FILE_BYTES).removeprefix("\ufeff"))  # some editors begin with it
        words = msgspec.convert(content, RoomWords)
    except OSError as exc:
        raise DataError(f"{path} cannot be read ({exc.strerror}); give a list of room words, a .toml") from exc
    except msgspec.ValidationError as exc:
        raise DataError(f"{path} is no list of room words: {exc}; {DEFAULT} is one to copy") from exc
    except ValueError as exc:
        raise DataError(f"{path} is no TOML file: {exc}; {DEFAULT} is one to copy") from exc
    if complaint := next(_complaints(words), None):
        raise DataError(f"{path}: {complaint}")
    return words


def _complaints(words: RoomWords) -> Iterator[str]:
    if not 0 < len(words.rooms) <= MAX_ROOMS:
        yield f"it has {len(words.rooms)} rooms; give 1 to {MAX_ROOMS}, each as [[rooms]]"
    for word in words.rooms:
        if not (
            0 < len(word.name) <= MAX_NAME and is_printable(word.name) and word.name == " ".join(word.name.split())
        ):
            yield f'the name "{word.name[:MAX_NAME]}" needs 1 to {MAX_NAME} characters that can be shown'
    phrases = [*words.nothing.looks_like, *(p for word in words.rooms for p in (*word.written, *word.looks_like))]
    for phrase in phrases:
        if not 0 < len(phrase) <= MAX_PHRASE or not is_printable(phrase):
            yield f'"{phrase[:40]}" needs 1 to {MAX_PHRASE} characters that can be shown'
    spelled: dict[str, str] = {}
    for word in words.rooms:
        for text in {_folded(s) for s in (*word.written, word.name)}:
            if text in spelled:
                yield f'"{text}" is written for {spelled[text]} and for {word.name}; leave it out of one of them'
            spelled[text] = word.name
