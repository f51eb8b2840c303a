"""The list of a backup: what it finds, puts right, and does not believe."""

from __future__ import annotations

import io
import random
import tarfile
import tracemalloc
from collections.abc import Callable, Sequence

import pytest

from station.maps import backup_list
from station.maps.address import address_of
from station.maps.backup_list import Listed, with_right_headers

CONTENTS = [number * b"0123456789" for number in (1, 100, 200)]
A, B, C = (address_of(content) for content in CONTENTS)
FILES = list(zip(["README.txt", f"records/map-0123456789ab.000001.{B}", f"blobs/{C[:2]}/{C}"], CONTENTS, strict=True))


def archive_of(files: Sequence[tuple[str, bytes]], *, more: bytes = b"", mtime: int = 0) -> bytes:
    """A tar of these files, and of its list, to which `more` is added."""
    out = io.BytesIO()
    listed: list[Listed] = []
    with tarfile.open(fileobj=out, mode="w|", format=tarfile.PAX_FORMAT) as archive:

        def add(name: str, data: bytes) -> None:
            member = tarfile.TarInfo(name)
            member.size, member.mtime = len(data), mtime
            archive.addfile(member, io.BytesIO(data))
            listed.append(Listed.behind(listed[-1] if listed else None, name, len(data)))

        for name, data in files:
            add(name, data)
        _, data = backup_list.encode(listed)
        data += more
        add(f"{backup_list.FOLDER}/{address_of(data)}", data)
    return out.getvalue()


WHOLE = archive_of(FILES)


def members_of(data: bytes) -> list[tarfile.TarInfo]:
    with tarfile.open(fileobj=io.BytesIO(data)) as archive:
        return archive.getmembers()


LIST = members_of(WHOLE)[-1]
END = LIST.offset_data + backup_list.padded(LIST.size)


def names_found(data: bytes) -> list[str] | None:
    found = backup_list.read(io.BytesIO(data))
    return None if found is None else [file.name for file in found.files()]


def put_right(data: bytes) -> tuple[bytes, list[str]]:
    found = backup_list.read(io.BytesIO(data))
    assert found is not None
    whole, names = with_right_headers(io.BytesIO(data), found)
    return whole.read(len(data)), names


def with_wrong_bits(data: bytes, *places: int) -> bytes:
    wrong = bytearray(data)
    for place in places:
        wrong[place] ^= 2
    return bytes(wrong)


def test_all_files_are_listed_with_the_headers_that_they_have() -> None:
    found = backup_list.read(io.BytesIO(WHOLE))
    assert found is not None and found.is_in_place
    assert [file.name for file in found.files()] == [member.name for member in members_of(WHOLE)]
    assert list(found.names()) == [name for name, _ in FILES]
    assert all(WHOLE[file.offset :].startswith(file.header) for file in found.files())


def test_headers_are_those_of_every_backup_that_was_written() -> None:
    """Bytes of 29 November 2026: another tarfile that writes others would find every header of a backup wrong."""

    def block(name: bytes, mode: bytes, size: bytes, checksum: bytes, kind: bytes) -> bytes:
        owner, mtime = 2 * b"0000000\0", b"00000000000\0"
        fields = name.ljust(100, b"\0"), mode, owner, size, mtime, checksum, kind.ljust(101, b"\0"), b"ustar\x0000"
        return b"".join(fields).ljust(512, b"\0")

    name = b"records/" + 100 * b"a"
    short = block(b"README.txt", b"0000644\0", b"00000000212\0", b"007436\0 ", b"0")
    pax = block(b"././@PaxHeader", b"0000000\0", b"00000000166\0", b"010220\0 ", b"x")
    path = (b"118 path=" + name + b"\n").ljust(512, b"\0")
    real = block(name[:100], b"0000644\0", b"00000000005\0", b"030737\0 ", b"0")
    assert Listed.behind(None, "README.txt", 138).header == short
    assert Listed.behind(None, name.decode(), 5).header == pax + path + real


def test_a_list_of_more_than_is_looked_at_at_once_is_found() -> None:
    names = [f"{number:0100d}" for number in range(12_000)]
    files: list[Listed] = []
    for name in names:
        files.append(Listed.behind(files[-1] if files else None, name, 0))
    name, data = backup_list.encode(files)
    assert len(data) > backup_list.PIECE
    last = Listed.behind(files[-1], name, len(data))
    whole = io.BytesIO()
    whole.seek(last.offset)
    whole.write(last.header + data + bytes(backup_list.padded(len(data)) - len(data) + 1024))
    found = backup_list.read(whole)
    assert found is not None and len(list(found.files())) == len(names) + 1


def test_one_wrong_bit_of_any_header_is_put_right_and_named() -> None:
    found = backup_list.read(io.BytesIO(WHOLE))
    assert found is not None
    rng = random.Random(3)
    for file in found.files():
        for at in range(file.offset, file.offset + len(file.header)):
            if file.name != LIST.name and rng.random() < 0.9:
                continue
            damaged = bytearray(WHOLE)
            damaged[at] ^= 1 << rng.randrange(8)
            assert put_right(bytes(damaged)) == (WHOLE, [file.name]), at - file.offset


def test_a_header_that_was_put_right_is_read_in_any_pieces() -> None:
    at = LIST.offset_data - 512 + 30
    damaged = with_wrong_bits(WHOLE, at)
    found = backup_list.read(io.BytesIO(damaged))
    assert found is not None
    whole, _ = with_right_headers(io.BytesIO(damaged), found)
    whole.seek(at)
    assert whole.read(1) == WHOLE[at : at + 1]


def test_a_header_that_is_lost_is_put_right_where_the_content_behind_it_is_there() -> None:
    for member in members_of(WHOLE)[1:-1]:
        for at in range(member.offset, member.offset_data, 512):
            assert put_right(WHOLE[:at] + bytes(512) + WHOLE[at + 512 :]) == (WHOLE, [member.name])


def test_of_an_archive_that_somebody_packed_anew_no_header_is_touched() -> None:
    member = members_of(WHOLE)[1]
    end = member.offset_data + backup_list.padded(member.size)
    without = WHOLE[: member.offset] + WHOLE[end:]
    assert put_right(without) == (without, [])
    assert names_found(without) is not None  # to tell what is missing
    # In another order: as many bytes, so that the list lies where it lay.
    other, last = archive_of([FILES[0], FILES[2], FILES[1]], mtime=10**9), LIST.offset
    packed = other[:last] + WHOLE[last:]
    assert put_right(packed) == (packed, [])
    # With one more file before the list, which then is not where its own lines put it.
    more = with_wrong_bits(WHOLE[:last], 30) + tarfile.TarInfo("more").tobuf() + WHOLE[last:]
    assert put_right(more) == (more, [])


@pytest.mark.parametrize(
    "damaged",
    [
        with_wrong_bits(WHOLE, END + 100),
        with_wrong_bits(WHOLE, LIST.offset_data + 5),
        with_wrong_bits(WHOLE, LIST.offset_data - 512 + 128, END + 700),
        with_wrong_bits(WHOLE, LIST.offset_data - 512 + 128, LIST.offset_data + 5),
        WHOLE[: END + 1024],
    ],
)
def test_a_list_is_found_by_what_is_left(damaged: bytes) -> None:
    assert names_found(damaged) == names_found(WHOLE)


@pytest.mark.parametrize(
    "damaged",
    [
        with_wrong_bits(WHOLE, END + 100, END + 700),  # something stands behind it
        WHOLE[: END + 512],
        WHOLE + bytes(tarfile.RECORDSIZE + 1024),
        with_wrong_bits(WHOLE, LIST.offset + 2, LIST.offset + 258),
        with_wrong_bits(WHOLE, LIST.offset + 330, LIST.offset + 340),
        with_wrong_bits(WHOLE, LIST.offset + 128, LIST.offset + 340),
        with_wrong_bits(WHOLE, LIST.offset_data + 5, LIST.offset_data + 6),
    ],
)
def test_what_is_more_damaged_is_no_list(damaged: bytes) -> None:
    assert names_found(damaged) is None


@pytest.mark.parametrize("more", [f"{10**30} far\n".encode(), b"-512 before\n", b"no number\n", b"\xff\xfe"])
def test_a_list_of_what_cannot_be_is_not_believed(more: bytes) -> None:
    assert names_found(archive_of(FILES, more=more)) is None


def claim(size: int, *wrong: int) -> bytes:
    header = tarfile.TarInfo(f"{backup_list.FOLDER}/{64 * 'a'}-{8 * 'b'}")
    header.size = size
    return with_wrong_bits(header.tobuf(tarfile.USTAR_FORMAT), *wrong)


def test_what_only_looks_like_a_list_is_passed_over_unread() -> None:
    data = claim(10**9) * 5000
    file = _CountedReading(data)
    assert backup_list.read(file) is None
    assert file.num_read < 3 * len(data)


def test_what_only_looks_like_lists_costs_no_more_than_it_is_long(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each looks like one that ends with the file, or that would with another bit."""
    count = 500
    data = b"".join(claim((count - 1 - number) * 512, 330, 340) for number in range(count)) + bytes(1024)
    calls = []

    def counted(real: Callable[..., object]) -> Callable[..., object]:
        def call(*args: object) -> object:
            calls.append(real)
            return real(*args)

        return call

    for name in ("frombuf", "tobuf"):
        monkeypatch.setattr(tarfile.TarInfo, name, counted(getattr(tarfile.TarInfo, name)))
    file = _CountedReading(data)
    assert backup_list.read(file) is None
    assert file.num_read < 3 * len(data) and len(calls) < count


def test_a_list_of_more_files_than_there_is_room_for_takes_no_memory() -> None:
    data = archive_of([], more=b"0 a\n" * 100_000)
    tracemalloc.start()
    try:
        found = backup_list.read(io.BytesIO(data))
        assert found is not None
        _, names = with_right_headers(io.BytesIO(data), found)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert names == [] and len(list(found.files())) == 1
    assert peak < 25 * len(data)


class _CountedReading(io.BytesIO):
    num_read = 0

    def read(self, size: int | None = -1, /) -> bytes:
        data = super().read(size)
        self.num_read += len(data)
        return data
