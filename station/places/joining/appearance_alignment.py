"""A registration from images: keyframes of the navigation, found in the map, say together how its frame lies there."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np

from shared.errors import RobotSystemError
from shared.geometry import (
    FloatArray,
    IntArray,
    carry_poses,
    orthonormal,
    rotation_angle,
    scale_of,
    sim3,
    so3_log,
    transform,
)
from station.model.frames import ImageFrame
from station.model.navigation import Navigation
from station.model.place_map import PlaceMap
from station.places.localisation.localizer import Localizer

MAX_QUERIES = 24  # keyframes asked for, evenly spread
MIN_AGREEING = 4  # independent images that must tell the same story
MIN_AGREEING_SHARE = 0.6  # of those that were found at all
MAX_POSITION_SHARE = 0.1  # of the viewing distance: agreement in position
MAX_ANGLE_RAD = 0.1  # agreement in rotation
MAX_SIGHTINGS = 3  # of a landmark by keyframes that are described: each costs some 50 ms
MIN_NEWS = 0.2  # share of a keyframe's landmarks without so many


@dataclass(frozen=True, slots=True, eq=False)
class AppearanceAlignment:
    """Where the navigation lies by its images alone."""

    T_map_nav: FloatArray  # (4, 4) with scale
    found: int  # keyframes found in the map
    asked: int
    agreeing: int  # of those found, how many fit T_map_nav
    covariance: FloatArray | None  # (7, 7) as in Registration, from how the agreeing ones scatter


def align_by_appearance(
    place_map: PlaceMap, navigation: Navigation, *, viewing_distance: float, fixed_scale: bool
) -> AppearanceAlignment | None:
    """Localise keyframes of the navigation in the map and find the motion most of them agree on.

    None where images are missing or nothing agrees. `viewing_distance` is the map's, map units.
    """
    T_map_cam, T_nav_cam, asked = _localize(place_map, navigation)
    found = agree_on_motion(
        T_map_cam, T_nav_cam, tolerance=MAX_POSITION_SHARE * viewing_distance, fixed_scale=fixed_scale
    )
    if found is None:
        return None
    T, agreeing = found
    covariance = covariance_of_motion(T_map_cam[agreeing], T_nav_cam[agreeing], fixed_scale=fixed_scale)
    return AppearanceAlignment(T, len(T_map_cam), asked, len(agreeing), covariance)


def agree_on_motion(
    T_map_cam: FloatArray, T_nav_cam: FloatArray, *, tolerance: float, fixed_scale: bool
) -> tuple[FloatArray, IntArray] | None:
    """The motion (4, 4) with scale that most poses agree on, and which (k,) do; None where too few do.

    Args:
        T_map_cam, T_nav_cam: (n, 4, 4) the same cameras in the map and in the navigation.
        tolerance: largest distance of an agreeing camera from where it was found, map units.
        fixed_scale: both frames are metric.
    """
    if len(T_map_cam) < MIN_AGREEING:
        return None
    best = np.zeros(0, dtype=np.int64)
    for i, j in itertools.combinations(range(len(T_map_cam)), 2):
        # Cameras closer together than this say nothing of the scale.
        if not fixed_scale and np.linalg.norm(T_map_cam[i, :3, 3] - T_map_cam[j, :3, 3]) < 0.5 * tolerance:
            continue
        T = _fit(T_map_cam[[i, j]], T_nav_cam[[i, j]], fixed_scale)
        agreeing = _agreeing(T, T_map_cam, T_nav_cam, tolerance)
        if len(agreeing) > len(best):
            best = agreeing
    if len(best) < max(MIN_AGREEING, MIN_AGREEING_SHARE * len(T_map_cam)):
        return None
    T = _fit(T_map_cam[best], T_nav_cam[best], fixed_scale)
    return T, _agreeing(T, T_map_cam, T_nav_cam, tolerance)


def _localize(place_map: PlaceMap, navigation: Navigation) -> tuple[FloatArray, FloatArray, int]:
    """Poses (n, 4, 4) of the keyframes that were found, in the map and in the navigation; and how many were asked."""
    keyframes = navigation.keyframes
    usable = [k for k, encoded in enumerate(keyframes.encoded) if encoded]
    mapped = any(place_map.navigation.keyframes.encoded)
    if not usable or not mapped or navigation.calibration.camera is None or not len(place_map.navigation.landmarks):
        return np.zeros((0, 4, 4)), np.zeros((0, 4, 4)), 0
    described = keyframes_with_news(place_map.navigation)
    pictures = place_map.navigation.keyframes.encoded
    thinned = replace(
        place_map.navigation.keyframes,
        encoded=tuple(picture if news else b"" for picture, news in zip(pictures, described, strict=True)),
    )
    localizer = Localizer([replace(place_map, navigation=replace(place_map.navigation, keyframes=thinned))])
    chosen = np.unique(np.linspace(0, len(usable) - 1, min(MAX_QUERIES, len(usable))).round().astype(int))
    in_map, in_nav = [], []
    for k in (usable[i] for i in chosen):
        frame = ImageFrame(int(keyframes.frame_index[k]), int(keyframes.t_robot_ns[k]), 0, keyframes.encoded[k])
        try:
            found = localizer.localize(frame, navigation.calibration)
        except RobotSystemError:
            continue  # one unreadable image is no reason to give up the others
        if found is not None:
            in_map.append(found.T_map_cam)
            in_nav.append(keyframes.T_world_cam[k])
    return np.array(in_map).reshape(-1, 4, 4), np.array(in_nav).reshape(-1, 4, 4), len(chosen)


def keyframes_with_news(navigation: Navigation) -> list[bool]:
    """(F,) which keyframes show enough landmarks that those before them leave open.

    A camera in the air makes a keyframe every 0.05 s, and each shows what its neighbours show: half of them will do. Of
    a map of rooms that somebody drove through nearly all are needed.
    """
    landmarks = navigation.landmarks
    sightings = np.zeros(len(landmarks), dtype=np.int64)
    has_news = []
    for observed in landmarks.observations_by_keyframe(len(navigation.keyframes)):
        seen = landmarks.observed_landmark[observed]
        has_news.append(bool(len(seen)) and float((sightings[seen] < MAX_SIGHTINGS).mean()) >= MIN_NEWS)
        sightings[seen] += has_news[-1]
    return has_news


def _fit(T_map_cam: FloatArray, T_nav_cam: FloatArray, fixed_scale: bool) -> FloatArray:
    """(4, 4) motion with scale that takes the navigation's poses onto the map's, rotations and positions both."""
    R = orthonormal(np.einsum("nij,nkj->ik", T_map_cam[:, :3, :3], T_nav_cam[:, :3, :3]))
    c_map, c_nav = T_map_cam[:, :3, 3], T_nav_cam[:, :3, 3]
    d_map, d_nav = c_map - c_map.mean(axis=0), (c_nav - c_nav.mean(axis=0)) @ R.T
    scale = 1.0
    if not fixed_scale:
        # Ratio of spreads instead of a projection: it does not shrink when positions are noisy.
        scale = float(np.sqrt((d_map**2).sum() / max((d_nav**2).sum(), 1e-12)))
    return sim3(scale, R, c_map.mean(axis=0) - scale * R @ c_nav.mean(axis=0))


def covariance_of_motion(T_map_cam: FloatArray, T_nav_cam: FloatArray, *, fixed_scale: bool) -> FloatArray | None:
    """(7, 7) of rotation, translation of the cameras' middle and log scale; None for fewer than three cameras.

    From what each camera (n, 4, 4) changes when it is left out. Cameras are taken to err each by itself; what bends
    the map or the navigation as a whole is not in it.
    Source: jackknife, Efron and Stein, Annals of Statistics 9(3), 1981.
    """
    count = len(T_map_cam)
    if count < 3:
        return None
    T = _fit(T_map_cam, T_nav_cam, fixed_scale)
    scale = scale_of(T)
    middle = T_nav_cam[:, :3, 3].mean(axis=0)
    changes = np.zeros((count, 7))
    for k in range(count):
        others = np.arange(count) != k
        T_k = _fit(T_map_cam[others], T_nav_cam[others], fixed_scale)
        scale_k = max(scale_of(T_k), 1e-9)
        changes[k, :3] = so3_log(T_k[:3, :3] @ T[:3, :3].T / (scale_k * scale))
        changes[k, 3:6] = transform(T_k - T, middle)
        changes[k, 6] = 0.0 if fixed_scale else np.log(scale_k / scale)
    changes -= changes.mean(axis=0)
    return (count - 1) / count * changes.T @ changes


def _agreeing(T: FloatArray, T_map_cam: FloatArray, T_nav_cam: FloatArray, tolerance: float) -> IntArray:
    carried = carry_poses(T, T_nav_cam)
    distance = np.linalg.norm(carried[:, :3, 3] - T_map_cam[:, :3, 3], axis=1)
    angle = rotation_angle(np.swapaxes(carried[:, :3, :3], 1, 2) @ T_map_cam[:, :3, :3])
    return np.flatnonzero((distance <= tolerance) & (angle <= MAX_ANGLE_RAD)).astype(np.int64)
