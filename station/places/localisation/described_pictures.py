"""Pictures described before anybody asks: while the robot drives there is time, when the map is wanted there is none.

Features are found by the picture's content, so whoever describes a picture first does it for all, with the same bits.
"""

from __future__ import annotations

import hashlib
import zipfile
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

import cv2
import numpy as np
import numpy.typing as npt

from shared.bounded import open_file
from shared.disk import replacing
from station.files.npz import UNREADABLE, Arrays, open_arrays
from station.files.spill import Spill
from station.vision.features import FeatureExtractor, Features, extract_encoded

A = TypeVar("A", bound=np.generic)


@dataclass(frozen=True, slots=True)
class Row(Generic[A]):
    """What one entry of an array in the file looks like."""

    dtype: np.dtype[A]
    size: int


DIGEST = Row(np.dtype(np.uint8), hashlib.sha256().digest_size)
UV = Row(np.dtype(np.float64), 2)
DESCRIPTOR = Row(np.dtype(np.uint8), 128)
VERSION = 4  # of how pictures are described: count it up when that changes
DESCRIBED_BY = f"{VERSION} cv2 {cv2.__version__} numpy {np.__version__}"


class DescribedPictures:
    """Features of encoded pictures. Holds a detector, so one per thread."""

    def __init__(self, up_deg: float | None = None) -> None:
        """`up_deg`: which way is up in the pictures (`Calibration.up_in_image_deg`)."""
        self.up_deg = up_deg
        self._extractor = FeatureExtractor(up_deg=up_deg)
        self._described_by = f"{DESCRIBED_BY} up {up_deg}"
        self._spill = Spill()
        self._known: dict[bytes, Features] = {}

    def __len__(self) -> int:
        return len(self._known)

    def knows(self, encoded: bytes) -> bool:
        return _digest(encoded) in self._known

    def describe(self, encoded: bytes) -> Features:
        """The picture's features, none where it cannot be decoded; computed once."""
        digest = _digest(encoded)
        if digest not in self._known:
            self._store_as(digest, extract_encoded(encoded, self._extractor))
        return self._known[digest]

    def store(self, encoded: bytes, features: Features) -> None:
        """Add what another FeatureExtractor found in the picture."""
        digest = _digest(encoded)
        if digest not in self._known:
            self._store_as(digest, features)

    def _store_as(self, digest: bytes, features: Features) -> None:
        self._known[digest] = Features(self._spill.put(features.uv_px), self._spill.put(features.descriptors))

    def keep_only(self, pictures: Iterable[bytes]) -> None:
        """Drop all others."""
        wanted = {_digest(encoded) for encoded in pictures}
        self._known = {digest: features for digest, features in self._known.items() if digest in wanted}

    def write(self, path: Path) -> None:
        """A file that `add` reads, there whole or not at all. One picture after the other: an hour has gigabytes.

        Raises:
            OSError: it cannot be written.
        """
        features = list(self._known.values())
        counts = [len(f) for f in features]
        with (
            replacing(path, scratch=path.with_name(f".{path.name}")) as file,
            zipfile.ZipFile(file, "w") as archive,
        ):
            described_by = np.array(self._described_by)
            _write_array(archive, "described_by", described_by.dtype, (), [described_by])
            digests = (np.frombuffer(digest, np.uint8) for digest in self._known)
            _write_array(archive, "digest", DIGEST.dtype, (len(features), DIGEST.size), digests)
            _write_array(archive, "count", np.dtype(np.int64), (len(features),), [np.array(counts, np.int64)])
            _write_array(archive, "uv_px", UV.dtype, (sum(counts), UV.size), (f.uv_px for f in features))
            descriptors = (f.descriptors for f in features)
            _write_array(archive, "descriptors", DESCRIPTOR.dtype, (sum(counts), DESCRIPTOR.size), descriptors)

    def add(self, path: Path) -> bool:
        """Take over what `write` wrote; False, and nothing is added, when it is gone, damaged or of another version."""
        try:
            with open_file(path) as file, open_arrays(file) as arrays:
                if str(arrays.read("described_by")) != self._described_by:
                    return False
                digests = [row.tobytes() for row in arrays.read("digest")]
                counts: list[int] = arrays.read("count").tolist()
                if len(digests) != len(counts) or min(counts, default=0) < 0:
                    return False
                uv_px = self._read_parts(arrays, "uv_px", UV, counts)
                descriptors = self._read_parts(arrays, "descriptors", DESCRIPTOR, counts)
        except UNREADABLE:
            return False
        self._known |= dict(zip(digests, map(Features, uv_px, descriptors), strict=True))
        return True

    def _read_parts(self, arrays: Arrays, name: str, row: Row[A], counts: list[int]) -> list[npt.NDArray[A]]:
        """Raises ValueError: other rows than these. BadZipFile: damaged, which is seen at the end."""
        parts = []
        with arrays.open(name) as (header, member):
            if (header.shape, header.dtype, header.in_columns) != ((sum(counts), row.size), row.dtype, False):
                raise ValueError(f"{name} has shape {header.shape} of {header.dtype}")
            for count in counts:
                data = member.read(count * row.size * row.dtype.itemsize)
                parts.append(self._spill.put(np.frombuffer(data, row.dtype).reshape(count, row.size)))
            if member.read(1):  # the checksum is compared at the end only
                raise ValueError(f"{name} is longer than its header says")
        return parts


def _write_array(
    archive: zipfile.ZipFile,
    name: str,
    dtype: np.dtype[Any],
    shape: tuple[int, ...],
    parts: Iterable[npt.NDArray[Any]],
) -> None:
    """As np.savez does, from parts that follow one another."""
    with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
        header = {"descr": np.lib.format.dtype_to_descr(dtype), "fortran_order": False, "shape": shape}
        np.lib.format.write_array_header_1_0(member, header)
        for part in parts:
            member.write(part.astype(dtype, copy=False).tobytes())


def _digest(encoded: bytes) -> bytes:
    return hashlib.sha256(encoded).digest()
