"""The list of words for rooms: what it says of a text, and what is wrong with one that cannot be used."""

from __future__ import annotations

from pathlib import Path

import pytest

from shared.errors import DataError
from station.places.naming.room_words import DEFAULT, default_words, load_room_words


def word_of(text: str) -> str | None:
    number = default_words().number_of(text)
    return None if number is None else default_words().rooms[number].name


def test_the_list_that_is_shipped_knows_rooms_in_several_languages_and_with_numbers() -> None:
    assert word_of("KITCHEN") == "Kitchen" and word_of("Küche") == "Kitchen" and word_of("Bedroom 2") == "Bedroom"
    assert word_of("WC") == "Toilet" and word_of("child's room") == "Child's room"
    assert word_of("Kitchenware") is None and word_of("2") is None and word_of("Room 2.14") is None


def test_a_word_that_was_read_without_its_accents_is_spelled_as_in_the_list() -> None:
    spelled = default_words().spelled
    assert [spelled(text) for text in ("KUCHE 2", "Gáste-WC", "BEDROOM", "Panasonic", "SALON", "Salón")] == [
        "Küche 2",
        "Gäste-WC",
        "Bedroom",
        None,
        "Salon",
        "Salón",
    ]


def test_every_shipped_word_says_what_it_looks_like() -> None:
    assert len(default_words().rooms) >= 7 and default_words().nothing.looks_like
    assert all(word.looks_like for word in default_words().rooms)


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        ("rooms = [", "no TOML file"),
        ("x = " + "9" * 5000, "no TOML file"),
        ("[[rooms]]\nnam = 'Kitchen'", "no list of room words"),
        ("[[rooms]]\nname = 7", "no list of room words"),
        ("[[rooms]]\nname = 'Kitchen'\nlooks = ['x']", "looks"),
        ("rooms = []", "0 rooms"),
        ("[[rooms]]\nname = ' '", "1 to 80 characters"),
        ("[[rooms]]\nname = 'Kitchen'\nlooks_like = ['']", "1 to 300 characters"),
        ("[[rooms]]\nname = 'A'\nwritten = ['x']\n[[rooms]]\nname = 'X'", "written for A and for X"),
        ("[[rooms]]\nname = 'K'\nwritten = ['\u202eK']", "can be shown"),
        ('[[rooms]]\nname = "K"\nlooks_like = ["\\u001b[31m"]', "can be shown"),
        (".".join("a" * 16_000) + " = 1", "more than 32 parts"),
        ("x = '" + "a" * 1_000_001 + "'", "more than"),
    ],
)
def test_a_list_that_cannot_be_used_is_refused_in_a_sentence(tmp_path: Path, content: str, complaint: str) -> None:
    path = tmp_path / "words.toml"
    path.write_text(content)
    with pytest.raises(DataError, match=complaint) as caught:
        load_room_words(path)
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)


def test_a_list_that_is_not_there_or_no_text_is_refused(tmp_path: Path) -> None:
    (tmp_path / "words.toml").write_bytes(b"\xff\xfe\x00")
    for path in (tmp_path / "none.toml", tmp_path, tmp_path / "words.toml"):
        with pytest.raises(DataError, match=str(path)):
            load_room_words(path)


@pytest.mark.timeout(20)
def test_what_gives_bytes_without_end_is_no_list() -> None:
    with pytest.raises(DataError, match="it is a device"):
        load_room_words(Path("/dev/zero"))


def test_the_default_can_be_copied(tmp_path: Path) -> None:
    for mark in (b"", b"\xef\xbb\xbf"):  # some editors begin a text with it
        (tmp_path / "mine.toml").write_bytes(mark + DEFAULT.read_bytes())
        assert load_room_words(tmp_path / "mine.toml") == default_words()
