"""What waits at a UDP socket: all of it, in order, and an error of whoever takes it is not hidden."""

from __future__ import annotations

import socket
from collections.abc import Iterator

import pytest

from shared.datagram_socket import READ_AT_ONCE, waiting_datagrams


@pytest.fixture
def pair() -> Iterator[tuple[socket.socket, socket.socket]]:
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as here,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as there,
    ):
        here.setblocking(False)
        here.bind(("127.0.0.1", 0))
        there.bind(("127.0.0.1", 0))
        there.connect(here.getsockname())
        yield here, there


@pytest.mark.parametrize("count", [0, 3, READ_AT_ONCE + 5])
def test_what_has_come_is_given_in_order_and_no_more_than_a_turn_of_it(
    pair: tuple[socket.socket, socket.socket], count: int
) -> None:
    here, there = pair
    sent = [bytes([number]) for number in range(count)]
    for datagram in sent:
        there.send(datagram)
    taken = list(waiting_datagrams(here))
    assert [datagram for datagram, _ in taken] == sent[:READ_AT_ONCE]
    assert {address for _, address in taken} <= {there.getsockname()}


def test_an_error_of_whoever_takes_one_is_its_own(pair: tuple[socket.socket, socket.socket]) -> None:
    here, there = pair
    there.send(b"picture")

    def keep() -> None:
        for _ in waiting_datagrams(here):
            raise OSError("the disk is full")

    with pytest.raises(OSError, match="disk"):
        keep()
