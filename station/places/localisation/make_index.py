"""What localisation makes of a map's pictures: described, indexed, and tried in the map."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from shared.geometry import FloatArray, rotation_angle
from station.model.place_map import PlaceMap
from station.places.localisation.described_pictures import DescribedPictures
from station.places.localisation.keyframe_features import LANDMARK_ANGLE_RAD, describe_keyframes
from station.places.localisation.localizer import Localizer
from station.places.localisation.map_index import MapIndex
from station.places.localisation.tried_pictures import TriedPicture
from station.vision.features import Features

MOST_TRIED = 120  # some 40 ms each; every other one of them says the same to half a unit of log odds


def make_index(
    place_map: PlaceMap,
    on_keyframe: Callable[[], None] = lambda: None,
    pictures: DescribedPictures | None = None,
) -> MapIndex:
    """Some 100 ms for each keyframe on one core, and 5 s; `on_keyframe` is called before each.

    `pictures`: what is described already; those that were turned otherwise than the map's are described anew.
    """
    up_deg = place_map.navigation.calibration.up_in_image_deg
    if pictures is None or pictures.up_deg != up_deg:
        pictures = DescribedPictures(up_deg)
    index = MapIndex.of_keyframes(describe_keyframes(place_map, pictures.describe, on_keyframe))
    return replace(index, tried=try_pictures(place_map, index, pictures.describe))


def try_pictures(
    place_map: PlaceMap, index: MapIndex, describe: Callable[[bytes], Features]
) -> tuple[TriedPicture, ...]:
    """What the map's own pictures give without the keyframes that looked at much the same."""
    navigation = place_map.navigation
    camera, poses = navigation.calibration.camera, navigation.keyframes.T_world_cam
    if camera is None or not len(poses):
        return ()
    localizer = Localizer([place_map], index=[index])
    far = [np.linalg.norm(k.p_map - T[:3, 3], axis=1) for k, T in zip(index.keyframes, poses, strict=True)]
    if not any(map(len, far)):
        return ()
    viewing = float(np.median(np.concatenate(far)))
    tried = []
    for k in np.unique(np.linspace(0, len(poses) - 1, MOST_TRIED).astype(int)).tolist():
        features = describe(navigation.keyframes.encoded[k])
        near = np.flatnonzero(_differing_rad(poses[k], poses, viewing) < LANDMARK_ANGLE_RAD)
        attempt = localizer.attempt_features([features], 0, camera, left_out=frozenset(near.tolist()))
        if attempt.candidates:
            tried.append(TriedPicture(poses[k], tuple(replace(z, map_id="") for z in attempt.candidates)))
    return tuple(tried)


def _differing_rad(T: FloatArray, others: FloatArray, viewing: float) -> FloatArray:
    """(n,) by what angle a view (4, 4) and others (n, 4, 4) see what stands `viewing` away from another side."""
    turns = rotation_angle(T[:3, :3].T @ others[:, :3, :3])
    return np.asarray(turns + np.linalg.norm(others[:, :3, 3] - T[:3, 3], axis=1) / viewing)
