"""A map's own pictures, looked for in the map as if a later drive had taken them.

Where each was taken is known, and the keyframes near it are left out. So the poses that are found, right and wrong, say
how much in this home looks alike: of equal doors, radiators and white walls every home has its own.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from shared.geometry import FloatArray
from station.model.place_answer import Localization

Arrays = Mapping[str, npt.NDArray[np.generic]]


@dataclass(frozen=True, slots=True, eq=False)
class TriedPicture:
    """One of them in which a pose was verified."""

    T_map_cam: FloatArray  # (4, 4) where it was taken
    candidates: tuple[Localization, ...]  # at least one; of no map's id, as an index may be of several


def tried_arrays(tried: Sequence[TriedPicture]) -> dict[str, npt.NDArray[np.generic]]:
    """Plain arrays; `tried_of_arrays` gives the pictures again."""
    found = [z for picture in tried for z in picture.candidates]
    numbers = [
        (z.num_inliers, z.inlier_ratio, z.sigma_position, z.keyframe_index, z.extent, z.num_features) for z in found
    ]
    return {
        "tried_pose": np.array([picture.T_map_cam for picture in tried], np.float64).reshape(-1, 4, 4),
        "tried_first": np.cumsum([0, *(len(picture.candidates) for picture in tried)]),
        "tried_found": np.array([z.T_map_cam for z in found], np.float64).reshape(-1, 4, 4),
        "tried_numbers": np.array(numbers, np.float64).reshape(-1, 6),
        "tried_landmarks": np.concatenate([np.zeros(0, np.int64), *(z.landmarks for z in found)]),
        "tried_first_landmark": np.cumsum([0, *(len(z.landmarks) for z in found)]),
    }


def tried_of_arrays(arrays: Arrays) -> tuple[TriedPicture, ...]:
    """Raises KeyError, ValueError, TypeError when these are others."""
    landmarks = itertools.pairwise(arrays["tried_first_landmark"].tolist())
    found = [
        Localization(
            t_robot_ns=0,
            T_map_cam=T.astype(np.float64, copy=False),
            num_inliers=int(inliers),
            inlier_ratio=ratio,
            sigma_position=sigma,
            keyframe_index=int(keyframe),
            map_id="",
            extent=extent,
            num_features=int(features),
            landmarks=arrays["tried_landmarks"][begin:end].astype(np.int64, copy=False),
        )
        for T, (inliers, ratio, sigma, keyframe, extent, features), (begin, end) in zip(
            arrays["tried_found"], arrays["tried_numbers"].tolist(), landmarks, strict=True
        )
    ]
    parts = itertools.pairwise(arrays["tried_first"].tolist())
    return tuple(
        TriedPicture(T.astype(np.float64, copy=False), tuple(found[begin:end]))
        for T, (begin, end) in zip(arrays["tried_pose"], parts, strict=True)
    )
