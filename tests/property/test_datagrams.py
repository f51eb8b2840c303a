"""Pictures in pieces: whatever a network does to them, no picture is ever another one, nor handed out twice."""

from __future__ import annotations

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shared.datagrams import HEADER, KEY_BYTES, MAX_DATAGRAM, WINDOW, Opener, Sealer
from shared.erasure import divide, multiply, parity, restore
from shared.picture_pieces import MAX_PARITY, MAX_PICTURE_BYTES, PIECE_BYTES, WHOLE_WITHIN_NS, Assembler, cut

KEY, OTHER_KEY, SESSION = bytes(range(KEY_BYTES)), bytes(KEY_BYTES), 77
ELEMENTS = st.integers(0, 255)


def content(seed: int, num_bytes: int) -> bytes:
    return random.Random(seed).randbytes(num_bytes)


@given(ELEMENTS, ELEMENTS, ELEMENTS)
def test_bytes_are_a_field(a: int, b: int, c: int) -> None:
    assert multiply(a, b) == multiply(b, a)
    assert multiply(a, b ^ c) == multiply(a, b) ^ multiply(a, c)
    assert multiply(multiply(a, b), c) == multiply(a, multiply(b, c))
    if b:
        assert multiply(divide(a, b), b) == a


@settings(deadline=None)
@given(
    num_pieces=st.integers(1, 40), num_parity=st.integers(0, 20), seed=st.integers(0, 2**32), size=st.integers(1, 40)
)
def test_any_pieces_as_many_as_there_were_restore_all(num_pieces: int, num_parity: int, seed: int, size: int) -> None:
    pieces = [content(seed + n, size) for n in range(num_pieces)]
    sent = dict(enumerate(pieces + parity(pieces, num_parity)))
    arrived = random.Random(seed).sample(sorted(sent), num_pieces)
    assert restore({number: sent[number] for number in arrived}, num_pieces) == pieces


def test_one_piece_of_parity_is_the_exclusive_or_of_the_pieces() -> None:
    assert parity([b"\x01\x80", b"\x03\xff", b"\x00\x01"], 1) == [b"\x02\x7e"]


@settings(deadline=None)
@given(
    sizes=st.lists(st.integers(1, 6 * PIECE_BYTES), min_size=1, max_size=6),
    num_parity=st.integers(0, 4),
    loss=st.floats(0, 0.6),
    seed=st.integers(0, 2**32),
)
def test_whatever_is_lost_damaged_repeated_reordered_or_forged_only_true_pictures_come_and_each_once(
    sizes: list[int], num_parity: int, loss: float, seed: int
) -> None:
    rng = random.Random(seed)
    sealer, forger = Sealer(KEY, SESSION), Sealer(OTHER_KEY, SESSION)
    # Their numbers in front: two of a byte each would be the same now and then.
    pictures = [bytes([n]) + content(seed + n, size - 1) for n, size in enumerate(sizes)]
    under_way: list[bytes] = []
    for number, picture in enumerate(pictures):
        for piece in cut(picture, number, num_parity):
            datagram = sealer.seal(piece)
            assert len(datagram) <= MAX_DATAGRAM
            if rng.random() >= loss:
                under_way += [datagram] * rng.choice([1, 1, 1, 2])
            if rng.random() < 0.2:
                damaged = bytearray(datagram)
                damaged[rng.randrange(len(damaged))] ^= rng.randrange(1, 256)
                under_way.append(bytes(damaged))
            if rng.random() < 0.1:
                under_way += [forger.seal(piece), rng.randbytes(rng.randrange(1500))]
    for _ in range(len(under_way) // 3):  # neighbours overtake each other
        at = rng.randrange(max(1, len(under_way) - 4))
        part = under_way[at : at + 5]
        rng.shuffle(part)
        under_way[at : at + 5] = part
    opener, assembler = Opener(KEY, SESSION), Assembler()
    opened = filter(None, map(opener.open, under_way))
    found = [whole for piece in opened if (whole := assembler.add(piece, 0)) is not None]
    places = [pictures.index(picture) for picture in found]  # ValueError: a wrong one
    assert places == sorted(set(places))


@settings(deadline=None)
@given(
    size=st.integers(1, 8 * PIECE_BYTES), num_parity=st.integers(0, 5), seed=st.integers(0, 2**32), more=st.booleans()
)
def test_a_picture_is_whole_exactly_where_no_more_is_lost_than_there_is_parity(
    size: int, num_parity: int, seed: int, more: bool
) -> None:
    picture, rng = content(seed, size), random.Random(seed)
    pieces = cut(picture, 3, num_parity)
    kept = rng.sample(pieces, len(pieces) - num_parity - more)
    assembler = Assembler()
    found = [whole for piece in kept if (whole := assembler.add(piece, 0)) is not None]
    assert found == ([] if more else [picture])


@given(st.binary(max_size=60))
def test_pieces_that_no_robot_sends_are_refused(rubbish: bytes) -> None:
    assembler = Assembler()
    pieces = cut(content(1, 3 * PIECE_BYTES), 0, 2)
    assembler.add(pieces[0], 0)
    assembler.add(rubbish, 0)
    assembler.add(pieces[1][: len(rubbish)], 0)
    assert assembler.add(pieces[3], 0) is None
    assert assembler.add(pieces[4], 0) == content(1, 3 * PIECE_BYTES)


def test_a_picture_whose_pieces_come_too_late_is_given_up() -> None:
    first, *others = cut(content(1, 3 * PIECE_BYTES), 0, 2)
    assembler = Assembler()
    assembler.add(first, 0)
    assert [assembler.add(piece, WHOLE_WITHIN_NS + 1) for piece in others] == [None] * 4


def test_a_picture_behind_a_newer_one_is_given_up() -> None:
    older, newer = (cut(content(n, 100), n, 1) for n in range(2))
    assembler = Assembler()
    older_large = cut(content(5, 2 * PIECE_BYTES), 0, 1)
    assert assembler.add(older_large[0], 0) is None
    assert assembler.add(newer[0], 0) == content(1, 100)
    assert assembler.add(older_large[1], 0) is None
    assert len(older) == 2


def test_the_largest_picture_has_room_for_its_parity() -> None:
    picture = content(1, MAX_PICTURE_BYTES)
    assembler = Assembler()
    pieces = cut(picture, 0, MAX_PARITY)
    assert [whole for piece in pieces[MAX_PARITY:] if (whole := assembler.add(piece, 0))] == [picture]


@given(st.lists(st.integers(0, 3 * WINDOW), max_size=200))
def test_no_datagram_is_opened_twice(numbers: list[int]) -> None:
    sealer = Sealer(KEY, SESSION)
    datagrams = [sealer.seal(b"x") for _ in range(3 * WINDOW + 1)]
    opener = Opener(KEY, SESSION)
    opened = [number for number in numbers if opener.open(datagrams[number]) is not None]
    assert len(opened) == len(set(opened))
    newest = -1
    for number in numbers:  # within the window each is opened once
        if number > newest - WINDOW:
            assert number in opened
        newest = max(newest, number)


@pytest.mark.parametrize("size", [0, 5, HEADER.size, HEADER.size + 16, MAX_DATAGRAM + 1])
def test_a_datagram_of_an_impossible_size_is_refused(size: int) -> None:
    assert Opener(KEY, SESSION).open(bytes(size)) is None
