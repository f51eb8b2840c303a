"""Small files that unpack to gigabytes or nest without end, made when a test needs them."""

from __future__ import annotations

import hashlib
import struct
import tarfile
import zipfile
import zlib
from io import BytesIO
from pathlib import Path

import lz4.frame
import numpy as np
import zstandard
from mcap.opcode import Opcode

from shared.mcap_recording import FRAME_TOPIC, IMAGE_TOPIC
from station.files.navigation_folder import OBSERVATIONS, save_navigation
from tests.support.navigations import small_navigation

MB = 1024 * 1024
MAGIC = b"\x89MCAP0\r\n"
ADDRESS = f"{'a' * 64}-{'b' * 8}"


def zeros_in_zstd(size: int) -> bytes:
    packer = zstandard.ZstdCompressor().compressobj()
    return b"".join([*(packer.compress(bytes(MB)) for _ in range(size // MB)), packer.flush()])


def zeros_in_lz4(size: int) -> bytes:
    packer = lz4.frame.LZ4FrameCompressor()
    packed = [packer.begin(size), *(packer.compress(bytes(MB)) for _ in range(size // MB)), packer.flush()]
    return b"".join(packed)


def mcap_of_chunks(path: Path, packed: bytes, compression: str, claimed: int, chunks: int = 1) -> Path:
    """`claimed`: the bytes that each chunk says it unpacks to."""
    body = struct.pack("<QQQI", 0, 1, claimed, 0) + _text(compression) + struct.pack("<Q", len(packed)) + packed
    header = _text("") + _text("sentinel-robot")
    path.write_bytes(MAGIC + _record(Opcode.HEADER, header) + _record(Opcode.CHUNK, body) * chunks)
    return path


def _record(kind: Opcode, body: bytes) -> bytes:
    return struct.pack("<BQ", kind, len(body)) + body


def _text(text: str) -> bytes:
    return struct.pack("<I", len(text)) + text.encode()


def mcap_of_equal_frames(path: Path, chunks: int) -> Path:
    """Each chunk is as large as one may be, and packs to some kilobytes: all its frames are the same."""
    channels = b"".join(
        _record(Opcode.CHANNEL, struct.pack("<HH", number, 0) + _text(topic) + _text("json") + _text(""))
        for number, topic in enumerate((FRAME_TOPIC, IMAGE_TOPIC))
    )
    frame = b'{"timestamp":{"sec":1,"nsec":2},"exposure_ns":3}'
    pair = b"".join(
        _record(Opcode.MESSAGE, struct.pack("<HIQQ", number, 0, 2, 2) + data)
        for number, data in enumerate((frame, b""))
    )
    content = channels + pair * (30 * MB // len(pair))
    return mcap_of_chunks(path, zstandard.compress(content), "zstd", len(content), chunks)


def backup_with_hole(path: Path, size: int) -> Path:
    """A GNU tar whose only file is a hole of this size, under the name of a map's file."""
    member = tarfile.TarInfo(f"blobs/aa/{ADDRESS}")
    member.type = tarfile.GNUTYPE_SPARSE
    header = bytearray(member.tobuf(tarfile.GNU_FORMAT))
    header[386:410] = b"%011o\0%011o\0" % (size, 0)  # one piece of no bytes at the end
    header[483:495] = b"%011o\0" % size
    path.write_bytes(_sealed(header) + bytes(1024))
    return path


def _sealed(header: bytearray) -> bytes:
    header[148:156] = b" " * 8
    header[148:156] = b"%06o\0 " % sum(header)
    return bytes(header)


def backup_of_nested_headers(path: Path, depth: int) -> Path:
    """Each header says that the name of the next one follows, which says the same."""
    member = tarfile.TarInfo("././@LongLink")
    member.type, member.size = tarfile.GNUTYPE_LONGNAME, 2
    path.write_bytes((member.tobuf(tarfile.GNU_FORMAT) + b"x\0".ljust(512, b"\0")) * depth)
    return path


def backup_with_records(path: Path, whole: Path, *records: tuple[str, bytes]) -> Path:
    """The backup `whole`, after records of these names and contents, whose checksums are right."""
    with tarfile.open(path, "w") as archive, tarfile.open(whole) as source:
        for name, content in records:
            address = f"{hashlib.sha256(content).hexdigest()}-{zlib.crc32(content):08x}"
            member = tarfile.TarInfo(f"records/{name}.{address}")
            member.size = len(content)
            archive.addfile(member, BytesIO(content))
        for member in source:
            archive.addfile(member, source.extractfile(member))
    return path


def navigation_with_packed_observations(folder: Path, size: int) -> Path:
    """A navigation whose observations are zeros in a zip file, a thousandth of their size."""
    save_navigation(small_navigation(), folder)
    with zipfile.ZipFile(folder / OBSERVATIONS, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in ("frame_index", "t_robot_ns", "T_world_cam"):
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                header = {"descr": "<i8", "fortran_order": False, "shape": (size // 8,)}
                np.lib.format.write_array_header_1_0(member, header)
                for _ in range(size // MB):
                    member.write(bytes(MB))
    return folder


def calibration_of_aliases(path: Path, doublings: int) -> Path:
    """Each line is the one before it, twice: nothing in memory until somebody looks at all of it."""
    lines = ["l0: &l0 [1, 1]", *(f"l{n}: &l{n} [*l{n - 1}, *l{n - 1}]" for n in range(1, doublings))]
    path.write_text("\n".join([*lines, f"resolution: *l{doublings - 1}", "intrinsics: [1, 1, 1, 1]"]))
    return path


def empty_png(width: int, height: int) -> bytes:
    """A picture of one colour and one bit a pixel, which decodes to eight or more."""
    packer = zlib.compressobj(9)
    rows = b"".join([*(packer.compress(bytes(1 + -(-width // 8))) for _ in range(height)), packer.flush()])
    head = struct.pack(">IIBBBBB", width, height, 1, 0, 0, 0, 0)
    chunks = ((b"IHDR", head), (b"IDAT", rows), (b"IEND", b""))
    packed = (struct.pack(">I", len(d)) + kind + d + struct.pack(">I", zlib.crc32(kind + d)) for kind, d in chunks)
    return b"\x89PNG\r\n\x1a\n" + b"".join(packed)
