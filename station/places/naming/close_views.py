"""Pictures that together show all of a map from as near as it ever was seen: what is costly is asked of these alone."""

from __future__ import annotations

import numpy as np

from shared.geometry import IntArray
from station.model.navigation import Navigation

NEARLY = 1.5  # times the least distance: what is written there is then at least two thirds as large as it ever was


def close_views(navigation: Navigation, least: int, most: int) -> IntArray:
    """Indices of keyframes, those first that show most landmarks from nearby which none before them did.

    Each adds at least `least` landmarks; there are `most` at most. A greedy cover: no other choice of as many pictures
    covers much more (1 - 1/e of it; Nemhauser, Wolsey and Fisher, Mathematical Programming 14, 1978).
    """
    keyframes, landmarks = navigation.keyframes, navigation.landmarks
    finite = np.asarray(np.isfinite(landmarks.p_world).all(axis=1))
    rows = np.flatnonzero(finite[landmarks.observed_landmark])
    landmark, keyframe = landmarks.observed_landmark[rows], landmarks.observed_keyframe[rows]
    distance = np.linalg.norm(landmarks.p_world[landmark] - keyframes.T_world_cam[keyframe, :3, 3], axis=1)
    nearest = np.full(len(landmarks), np.inf)
    np.minimum.at(nearest, landmark, distance)
    near = distance <= NEARLY * nearest[landmark]
    landmark, keyframe = landmark[near], keyframe[near]
    chosen: list[int] = []
    while len(chosen) < most:
        gain = np.bincount(keyframe, minlength=len(keyframes))
        best = int(gain.argmax()) if len(gain) else -1
        if best < 0 or gain[best] < least:
            break
        chosen.append(best)
        is_shown = np.zeros(len(landmarks), dtype=bool)
        is_shown[landmark[keyframe == best]] = True
        left = ~is_shown[landmark]
        landmark, keyframe = landmark[left], keyframe[left]
    return np.array(chosen, dtype=np.int64)
