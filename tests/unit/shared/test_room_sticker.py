"""What a sticker's code says, and which codes name a room."""

import numpy as np
import pytest

from shared.errors import ConfigError
from shared.room_sticker import MAX_BYTES, is_ours, room_named_by, sticker_modules
from station.vision.codes import read_codes


@pytest.mark.parametrize("name", ["Kitchen", "Schlafzimmer Süd", "子供部屋"])
def test_what_is_printed_is_read_again(name: str) -> None:
    modules = np.pad(sticker_modules(name), 4)
    (code,) = read_codes(np.kron(np.where(modules, 0, 255), np.ones((6, 6))).astype(np.uint8))
    assert is_ours(code.text) and room_named_by(code.text) == name
    np.testing.assert_allclose(code.corners_px[0], [23.5, 23.5], atol=1.0)


def test_a_name_that_needs_too_fine_modules_is_refused() -> None:
    with pytest.raises(ConfigError, match="shorten it"):
        sticker_modules("x" * 50)


@pytest.mark.parametrize("letter", ["x", "ü", "я", "厨", "😀"])
def test_the_limit_that_is_told_is_the_one_that_holds(letter: str) -> None:
    """Of Latin letters exactly so many fit; of others, fewer than that, as is said, and at least a quarter."""
    fits = [n for n in range(1, MAX_BYTES + 2) if _fits(letter * n)]
    assert max(fits) == MAX_BYTES if letter in "xü" else MAX_BYTES // 4 <= max(fits) < MAX_BYTES
    with pytest.raises(ConfigError, match=f"holds {MAX_BYTES} bytes"):
        sticker_modules(letter * (MAX_BYTES + 1))


def _fits(name: str) -> bool:
    try:
        sticker_modules(name)
    except ConfigError:
        return False
    return True


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("sentinel:room:Kitchen", "Kitchen"),
        ("room:  the  den ", "the den"),
        ("Living room", "Living room"),
        ("WIFI:S:home;;", None),
        ("https://example.org", None),
        ("ROOM:", None),
        ("ROOM:a\x1bb", None),
        ("4006381333931", None),
        ("this is a longer sentence", None),
    ],
)
def test_only_names_are_taken_for_names(text: str, name: str | None) -> None:
    assert room_named_by(text) == name
