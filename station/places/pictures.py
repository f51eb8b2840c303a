"""Pictures described before anybody asks: while the robot drives there is time, when the map is wanted there is none.

Features are found by the picture's content, so whoever describes a picture first does it for all, with the same bits.
"""

from __future__ import annotations

import hashlib
import io
import itertools
import zipfile
from collections.abc import Iterable

import cv2
import numpy as np

from station.places.features import FeatureExtractor, Features, extract_encoded
from station.shelf import Shelf

VERSION = 1  # of how pictures are described: count it up when that changes
DESCRIBED_BY = f"{VERSION} cv2 {cv2.__version__} numpy {np.__version__}"


class DescribedPictures:
    """Features of encoded pictures. Holds a detector, so one per thread."""

    def __init__(self) -> None:
        self._extractor = FeatureExtractor()
        self._shelf = Shelf()
        self._known: dict[bytes, Features] = {}

    def __len__(self) -> int:
        return len(self._known)

    def knows(self, encoded: bytes) -> bool:
        return _digest(encoded) in self._known

    def describe(self, encoded: bytes) -> Features:
        """The picture's features, none where it cannot be decoded; kept for the next who asks."""
        digest = _digest(encoded)
        if digest not in self._known:
            found = extract_encoded(encoded, self._extractor)
            self._known[digest] = Features(self._shelf.put(found.uv_px), self._shelf.put(found.descriptors))
        return self._known[digest]

    def keep_only(self, pictures: Iterable[bytes]) -> None:
        """Forget all others."""
        wanted = {_digest(encoded) for encoded in pictures}
        self._known = {digest: features for digest, features in self._known.items() if digest in wanted}

    def encode(self) -> bytes:
        """A file that `add` reads."""
        features = list(self._known.values())
        file = io.BytesIO()
        np.savez(
            file,
            described_by=np.array(DESCRIBED_BY),
            digest=np.frombuffer(b"".join(self._known), np.uint8).reshape(-1, hashlib.sha256().digest_size),
            first=np.cumsum([0, *(len(f) for f in features)]),
            uv_px=np.concatenate([np.zeros((0, 2)), *(f.uv_px for f in features)]),
            descriptors=np.concatenate([np.zeros((0, 128), np.uint8), *(f.descriptors for f in features)]),
        )
        return file.getvalue()

    def add(self, file: bytes) -> bool:
        """Take over what `encode` gave; False, and nothing is added, when it is damaged or of another version."""
        try:
            with np.load(io.BytesIO(file), allow_pickle=False) as archive:
                if str(archive["described_by"]) != DESCRIBED_BY:
                    return False
                digests, first = archive["digest"].astype(np.uint8), archive["first"].tolist()
                uv_px = archive["uv_px"].astype(np.float64).reshape(-1, 2)
                descriptors = archive["descriptors"].astype(np.uint8).reshape(-1, 128)
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
            return False
        if len(first) != len(digests) + 1 or not first[-1] == len(uv_px) == len(descriptors):
            return False
        for digest, (begin, end) in zip(digests, itertools.pairwise(first), strict=True):
            self._known[digest.tobytes()] = Features(uv_px[begin:end], descriptors[begin:end])
        return True


def _digest(encoded: bytes) -> bytes:
    return hashlib.sha256(encoded).digest()
