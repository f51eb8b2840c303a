"""The sticker that names a room: what its code says, how large it is, and its modules.

Measured (docs/names.md): 17 cm hold the usual names in modules of 6.8 to 8.1 mm, which are 2.5 px wide or more from
1.5 m through a lens of 60 degrees. Error correction M, since L was read no more often and corrects half as much.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import zxingcpp

from shared.errors import ConfigError
from shared.text import is_printable

PREFIX = "ROOM:"  # capitals and a colon take less room in a code than "sentinel:room:" would
OTHER_PREFIXES = ("sentinel:room:",)  # also read
CODE_SIDE_M = 0.17  # of the code without its white rim; what the printed page says as well
MAX_MODULES = 29  # in a row: longer names would need finer ones
MAX_BYTES = 42 - len(PREFIX)  # of a name: a code of 29 modules at level M holds 42 (ISO/IEC 18004, table 7)
MAX_READ = 80  # characters of a name


def sticker_modules(name: str) -> npt.NDArray[np.bool_]:
    """(n, n) which modules are black, first row on top. Raises ConfigError: the name is too long."""
    code = zxingcpp.create_barcode(PREFIX + name, zxingcpp.BarcodeFormat.QRCode, ec_level="M")
    modules = np.array(code.to_image(scale=1, add_quiet_zones=False)) == 0
    if len(modules) > MAX_MODULES:
        raise ConfigError(
            f'the name "{name}" is too long to be read from a sticker, which holds {MAX_BYTES} bytes of it '
            "(a Latin letter is one, others are up to four); shorten it"
        )
    return np.asarray(modules)


def is_ours(text: str) -> bool:
    """Whether a code says itself that it names a room."""
    return _without_prefix(text) is not None


def room_named_by(text: str) -> str | None:
    """The room's name that a code gives; None for a code that is about something else.

    Plain text of up to four words is a name too. Links, Wi-Fi keys, contacts and the like have a colon or an equals
    sign; serial numbers are digits for the most part.
    """
    named = _without_prefix(text)
    name = " ".join((text if named is None else named).split())
    if not 0 < len(name) <= MAX_READ or not is_printable(name):
        return None
    if named is None and not _reads_like_a_name(name):
        return None
    return name


def _without_prefix(text: str) -> str | None:
    for prefix in (PREFIX, *OTHER_PREFIXES):
        if text[: len(prefix)].casefold() == prefix.casefold():
            return text[len(prefix) :]
    return None


def _reads_like_a_name(text: str) -> bool:
    letters = sum(c.isalpha() for c in text)
    return letters > len(text) / 2 and len(text.split()) <= 4 and not any(c in text for c in ":=/@<>{}\\")
