"""Bytes kept under their address, and never given back unless they are what the address says."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Iterator

from shared.disk import SCRATCH
from shared.errors import DataError
from station.maps.address import address_of, heal, is_whole
from station.maps.bucket import Bucket, Unreadable

FOLDER = "blobs"
REPAIR_OR_RESTORE = "run `station map repair` or restore a backup"
RENEWED_AFTER_S = 12 * 3600.0
Notify = Callable[[str], None]


class Damaged(DataError):
    """Some bytes are not what they were; the sentence names the file."""


class Blobs:
    """Content-addressed files in a bucket. `notify` hears a sentence about every file that was wrong and put right."""

    def __init__(self, bucket: Bucket, notify: Notify = lambda _: None) -> None:
        self._bucket = bucket
        self._notify = notify

    def put(self, contents: Iterable[bytes]) -> list[str]:
        """Their addresses, in order. What is there already, whole and young, is not written again.

        What nobody needed for long may be tidied away at any moment: written again it is young.
        """
        named = [(address_of(data), data) for data in contents]
        missing = {
            blob_name(address): data
            for address, data in dict(named).items()
            if not self._is_there(address) or self._age_s(address) > RENEWED_AFTER_S
        }
        self._bucket.put(missing)
        return [address for address, _ in named]

    def get(self, address: str, what: str) -> bytes:
        """The bytes; `what` is what the sentence calls them. Raises Damaged when they are missing or wrong."""
        return read_checked(self._bucket, blob_name(address), address, what, self._notify)

    def remove(self, address: str, older_than_s: float) -> bool:
        """Unless it was written again meanwhile."""
        if self._age_s(address) <= older_than_s:
            return False
        self._bucket.remove(blob_name(address))
        return True

    def _is_there(self, address: str) -> bool:
        there = None
        with contextlib.suppress(Unreadable):
            there = self._bucket.get(blob_name(address))
        return there is not None and is_whole(there, address)

    def _age_s(self, address: str) -> float:
        name = blob_name(address)
        return next((age_s for other, age_s in self._bucket.names(name.rpartition("/")[0]) if other == name), 0.0)

    def addresses(self) -> Iterator[tuple[str, float]]:
        """All that are there, with their age in seconds."""
        for name, age_s in self._bucket.names(FOLDER):
            if not (last := name.rpartition("/")[2]).startswith(SCRATCH):
                yield last, age_s


def blob_name(address: str) -> str:
    return f"{FOLDER}/{address[:2]}/{address}"


def read_checked(bucket: Bucket, name: str, address: str, what: str, notify: Notify) -> bytes:
    """A file of a bucket, checked; one wrong bit is put right, in the bucket too where it can be written."""
    try:
        data = bucket.get(name)
    except Unreadable as exc:
        raise Damaged(f"{what}: {str(exc).partition(';')[0]}; {REPAIR_OR_RESTORE}") from exc
    if data is None:
        raise Damaged(f"{what} ({bucket.place}/{name}) is missing; {REPAIR_OR_RESTORE}")
    if is_whole(data, address):
        return data
    healed = heal(data, address)
    if healed is None:
        raise Damaged(f"{what} ({bucket.place}/{name}) is damaged (its checksum differs); {REPAIR_OR_RESTORE}")
    try:
        bucket.put({name: healed})
        notify(f"{what} ({bucket.place}/{name}) had one wrong bit; it is put right. Check the disk")
    except DataError:
        notify(f"{what} ({bucket.place}/{name}) has one wrong bit and cannot be written; it is used put right")
    return healed
