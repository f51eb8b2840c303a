"""The list of a backup: what it finds, puts right, and does not believe."""

from __future__ import annotations

import io
import random
import tarfile

import pytest

from station.maps import backup_list
from station.maps.backup_list import Listed, with_right_headers

CONTENT = b"0123456789" * 100


def archive_of(names: list[str], *, more: bytes = b"") -> bytes:
    """A tar of these files, and of its list, to which `more` is added."""
    out = io.BytesIO()
    files: list[Listed] = []
    with tarfile.open(fileobj=out, mode="w|", format=tarfile.PAX_FORMAT) as archive:

        def add(name: str, data: bytes) -> None:
            member = tarfile.TarInfo(name)
            member.size = len(data)
            archive.addfile(member, io.BytesIO(data))
            files.append(Listed.behind(files[-1] if files else None, name, len(data)))

        for name in names:
            add(name, CONTENT)
        _, data = backup_list.encode(files)
        data += more
        add(f"{backup_list.FOLDER}/{backup_list.address_of(data)}", data)
    return out.getvalue()


def names_in(data: bytes) -> list[str]:
    with tarfile.open(fileobj=io.BytesIO(data)) as archive:
        return archive.getnames()


NAMES = ["README.txt", "records/" + 120 * "a", "blobs/aa/b"]


def test_all_files_are_listed_with_the_headers_that_they_have() -> None:
    data = archive_of(NAMES)
    files = backup_list.read(io.BytesIO(data))
    assert [file.name for file in files] == names_in(data)
    assert all(data[file.offset :].startswith(file.header) for file in files)


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
    assert len(backup_list.read(whole)) == len(names) + 1


def test_one_wrong_bit_of_any_header_is_put_right_and_named() -> None:
    data = archive_of(NAMES)
    files = backup_list.read(io.BytesIO(data))
    rng = random.Random(3)
    for file in files:
        for _ in range(40):
            at = rng.randrange(file.offset, file.offset + len(file.header))
            damaged = bytearray(data)
            damaged[at] ^= 1 << rng.randrange(8)
            found = backup_list.read(io.BytesIO(damaged))
            whole, names = with_right_headers(io.BytesIO(damaged), found)
            assert names == [file.name], at - file.offset
            assert whole.read(len(data)) == data
            whole.seek(at)
            assert whole.read(1) == data[at : at + 1]


@pytest.mark.parametrize("more", [f"{10**30} far\n".encode(), b"-512 before\n", b"no number\n", b"\xff\xfe"])
def test_a_list_of_what_cannot_be_is_not_believed(more: bytes) -> None:
    assert backup_list.read(io.BytesIO(archive_of(NAMES, more=more))) == []


def test_what_only_looks_like_a_list_is_passed_over_unread() -> None:
    claims = tarfile.TarInfo(f"{backup_list.FOLDER}/{64 * 'a'}-{8 * 'b'}")
    claims.size = 10**9
    data = claims.tobuf(tarfile.USTAR_FORMAT) * 5000
    file = _CountedReading(data)
    assert backup_list.read(file) == []
    assert file.num_read < 3 * len(data)


class _CountedReading(io.BytesIO):
    num_read = 0

    def read(self, size: int | None = -1, /) -> bytes:
        data = super().read(size)
        self.num_read += len(data)
        return data
