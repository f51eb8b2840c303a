"""CPace against the test vectors of its draft (draft-irtf-cfrg-cpace, appendix B.1)."""

from __future__ import annotations

import pytest

from shared.cpace import generator, multiply, session_key
from shared.errors import RemoteProtocolError
from shared.pairing import Pake

SID = bytes.fromhex("7e4b4791d6a8ef019b936c79fb7f2c57")
POINT = "64e8099e3ea682cfdc5cb665c057ebb514d06bf23ebc9f743b51b82242327074"
SCALAR_A = bytes.fromhex("21b4f4bd9e64ed355c3eb676a28ebedaf6d8f17bdc365995b319097153044080")
SCALAR_B = bytes.fromhex("848b0779ff415f0af4ea14df9dd1d3c29ac41d836c7808896c4eba19c51ac40a")
SHARE_A = "1b02dad6dbd29a07b6d28c9e04cb2f184f0734350e32bb7e62ff9dbcfdb63d15"
SHARE_B = "20cda5955f82c4931545bcbf40758ce1010d7db4db2a907013d79c7a8fcf957f"
SECRET = "f97fdfcfff1c983ed6283856a401de3191ca919902b323c5f950c9703df7297a"
KEY = (
    "a051ee5ee2499d16da3f69f430218b8ea94a18a45b67f9e86495b382c33d14a5"
    "c38cecc0cc834f960e39e0d1bf7d76b9ef5d54eecc5e0f386c97ad12da8c3d5f"
)
LOW_ORDER = [
    "0000000000000000000000000000000000000000000000000000000000000000",
    "0100000000000000000000000000000000000000000000000000000000000000",
    "ecffffffffffffffffffffffffffffffffffffffffffffffffffffffffffff7f",
    "e0eb7a7c3b41b8ae1656e3faf19fc46ada098deb9c32b1fd866205165f49b800",
    "5f9c95bca3508c24b1d0b1559c83ef5b04445cc4581c8e86d8224eddd09f1157",
    "edffffffffffffffffffffffffffffffffffffffffffffffffffffffffffff7f",
    "eeffffffffffffffffffffffffffffffffffffffffffffffffffffffffffff7f",
]


def test_a_code_becomes_the_drafts_point() -> None:
    assert generator(b"Password", b"oc\x0bB_responder\x0bA_initiator", SID).hex() == POINT


def test_shares_secret_and_key_are_the_drafts() -> None:
    point = bytes.fromhex(POINT)
    share_a, share_b = multiply(SCALAR_A, point), multiply(SCALAR_B, point)
    assert (share_a.hex(), share_b.hex()) == (SHARE_A, SHARE_B)
    assert multiply(SCALAR_A, share_b).hex() == multiply(SCALAR_B, share_a).hex() == SECRET
    assert session_key(bytes.fromhex(SECRET), (share_a, b"ADa"), (share_b, b"ADb"), SID).hex() == KEY


@pytest.mark.parametrize("point", LOW_ORDER)
def test_points_that_would_fix_the_key_are_refused(point: str) -> None:
    with pytest.raises(ValueError, match=r".*"):
        multiply(SCALAR_A, bytes.fromhex(point))
    with pytest.raises(RemoteProtocolError, match="not valid"):
        Pake("robot", "123456", b"f").receive(b"C" + bytes.fromhex(point))


@pytest.mark.parametrize(
    ("first", "words"), [(b"A", "earlier release"), (b"B", "earlier release"), (b"D", "not valid")]
)
def test_another_exchange_is_named(first: bytes, words: str) -> None:
    with pytest.raises(RemoteProtocolError, match=words):
        Pake("robot", "123456", b"f").receive(first + bytes.fromhex(SHARE_A))


def test_another_code_channel_or_session_is_another_point() -> None:
    points = {generator(code, channel, sid) for code in (b"1", b"2") for channel in (b"a", b"b") for sid in (b"", b"s")}
    assert len(points) == 8


def test_a_part_longer_than_127_bytes_is_joined_without_ambiguity() -> None:
    assert generator(b"1", bytes(200), b"") != generator(b"1", bytes(199), b"\0")
