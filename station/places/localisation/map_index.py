"""A map's pictures as localisation looks at them: made once, and plain arrays, so that many robots can share them."""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import msgspec
import numpy as np
import numpy.typing as npt

from station.model.place_map import PlaceMap
from station.places.localisation.described_pictures import DESCRIBED_BY
from station.places.localisation.keyframe_features import KeyframeFeatures
from station.places.localisation.region_pose import MIN_MATCHES
from station.places.localisation.tried_pictures import Arrays, TriedPicture, tried_arrays, tried_of_arrays
from station.vision.appearance import AppearanceIndex

VERSION = 6  # of how described pictures are indexed and tried: count it up when that changes


@dataclass(frozen=True, slots=True, eq=False)
class MapIndex:
    """What `Localizer` needs of one map."""

    keyframes: tuple[KeyframeFeatures, ...]
    appearance: AppearanceIndex
    tried: tuple[TriedPicture, ...] = ()  # the map's own pictures

    @classmethod
    def of_keyframes(cls, described: Sequence[KeyframeFeatures]) -> MapIndex:
        """A keyframe on which no pose can rest is not proposed: it would take the place of one that can give it."""
        nothing = np.zeros((0, 128), np.uint8)
        shown = [k.all_descriptors if len(k.landmark) >= MIN_MATCHES else nothing for k in described]
        return cls(tuple(described), AppearanceIndex(shown))

    def arrays(self) -> dict[str, npt.NDArray[np.generic]]:
        """All of it but the descriptors that have no position: they have made the appearance, and are not needed."""
        of_keyframes = {
            "descriptors": np.concatenate([np.zeros((0, 128), np.uint8), *(k.descriptors for k in self.keyframes)]),
            "p_map": np.concatenate([np.zeros((0, 3)), *(k.p_map for k in self.keyframes)]),
            "landmark": np.concatenate([np.zeros(0, np.int64), *(k.landmark for k in self.keyframes)]),
            "first": np.cumsum([0, *(len(k.landmark) for k in self.keyframes)]),
        }
        return {**of_keyframes, **self.appearance.arrays(), **tried_arrays(self.tried)}

    @classmethod
    def of_arrays(cls, arrays: Arrays) -> MapIndex:
        """What `arrays` gave. Raises KeyError, ValueError when these are others."""
        first = arrays["first"].tolist()
        keyframes = tuple(
            KeyframeFeatures(
                descriptors=arrays["descriptors"][begin:end].astype(np.uint8, copy=False),
                p_map=arrays["p_map"][begin:end].astype(np.float64, copy=False),
                landmark=arrays["landmark"][begin:end].astype(np.int64, copy=False),
                all_descriptors=np.zeros((0, 128), np.uint8),
            )
            for begin, end in itertools.pairwise(first)
        )
        return cls(keyframes, AppearanceIndex.of_arrays(len(keyframes), arrays), tried_of_arrays(arrays))


def fingerprint(place_map: PlaceMap) -> str:
    """A digest of all that the index is made from: it does not change with the places' names."""
    navigation = place_map.navigation
    landmarks, keyframes = navigation.landmarks, navigation.keyframes
    digest = hashlib.sha256(f"{VERSION} of {DESCRIBED_BY}".encode())
    digest.update(msgspec.json.encode(navigation.calibration))
    arrays = (landmarks.p_world, landmarks.observed_keyframe, landmarks.observed_landmark, landmarks.observed_uv_px)
    for array in (*arrays, keyframes.T_world_cam):
        digest.update(f"{array.dtype} {array.shape}".encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    for encoded in keyframes.encoded:
        digest.update(len(encoded).to_bytes(8, "big") + encoded)
    return digest.hexdigest()
