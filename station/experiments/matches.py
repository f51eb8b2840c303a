"""Matches judged by truth: is the location really where the place is? Judges only; nothing estimates with this."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from shared.errors import DataError
from shared.geometry import FloatArray, IntArray, inverse, transform
from station.datasets import Truth
from station.experiments.alignment import align_points
from station.model.navigation import Navigation
from station.model.place_map import Place, PlaceMap
from station.places.joining.match_result import MatchResult, PlaceMatch
from station.places.making.clusters import MIN_LANDMARKS
from station.places.making.scale import half_extent

MAX_GAP_NS = 60_000_000  # a true pose farther in time than this does not belong to a keyframe
SHARED_SHARE = 0.15  # of a place's half extent: landmarks closer than this are of one surface
CO_VISIBLE_SHARE = 0.5  # a place is co-visible when so many of its landmarks were in view again
MIN_VIEWS = 3
MAX_VIEW_SHARE = 2.0  # of the distance landmarks are seen from: farther ones are not reconstructed


@dataclass(frozen=True, slots=True)
class JudgedMatch:
    """A match and what truth says of it."""

    match: PlaceMatch
    true_distance: float  # between the true centroids, metres
    half_extent: float  # of the place, metres
    correct: bool


@dataclass(frozen=True, slots=True)
class MatchJudgement:
    """All matches of one navigation."""

    judged: tuple[JudgedMatch, ...]
    co_visible: tuple[str, ...]  # ids of the places that the navigation really saw again
    precision: float | None  # None without matches
    recall: float | None  # None without co-visible places
    rand_index: float | None  # adjusted, of places against locations on the shared space; None without any
    registration_error: float | None  # median error of the carried landmarks, metres; None without registration
    duplicates: int  # places that stand for the same real place as another one


def judge_matches(
    place_map: PlaceMap, truth_map: Truth, navigation: Navigation, truth_nav: Truth, result: MatchResult
) -> MatchJudgement:
    """Judge every match by where the clusters' landmarks truly are.

    Raises:
        DataError: fewer than three keyframes of a navigation have a true pose.
    """
    p_map = true_landmarks(place_map.navigation, truth_map)
    p_nav = true_landmarks(navigation, truth_nav)
    place_of = {place.id: place for place in place_map.places}
    location_of = {location.id: location for location in result.locations}
    judged = tuple(
        _judge(
            match, p_map[place_of[match.place_id].landmark_index], p_nav[location_of[match.location_id].landmark_index]
        )
        for match in result.matches
    )
    co_visible = co_visible_places(place_map.places, p_map, navigation, truth_nav, p_nav)
    right = {j.match.place_id for j in judged if j.correct}
    return MatchJudgement(
        judged=judged,
        co_visible=co_visible,
        precision=float(np.mean([j.correct for j in judged])) if judged else None,
        recall=len(right & set(co_visible)) / len(co_visible) if co_visible else None,
        rand_index=shared_rand_index(p_map, place_map.places, p_nav, result.clusters.label),
        registration_error=_registration_error(place_map.navigation, p_map, navigation, p_nav, result),
        duplicates=count_duplicates(place_map.places, p_map),
    )


def true_landmarks(navigation: Navigation, truth: Truth) -> FloatArray:
    """(M, 3) where the landmarks truly are: carried by the true poses of the keyframes that saw them.

    Each landmark is taken into the cameras that saw it, scaled by the trajectory's scale (Umeyama), put back with
    their true poses, and averaged: SLAM's drift cancels, its triangulation error stays. NaN for landmarks that no
    keyframe with a true pose saw.
    """
    T_true_cam = true_cameras(navigation, truth)
    known = np.isfinite(T_true_cam[:, 0, 0])
    if np.count_nonzero(known) < 3:
        raise DataError(f"{np.count_nonzero(known)} keyframes of {navigation.id} have a true pose, judging needs 3")
    T_nav_cam = navigation.keyframes.T_world_cam
    scale = align_points(T_true_cam[known, :3, 3], T_nav_cam[known, :3, 3], "sim3").scale
    landmarks = navigation.landmarks
    total, count = np.zeros((len(landmarks), 3)), np.zeros(len(landmarks))
    observed = landmarks.observations_by_keyframe(len(known))
    for k in np.flatnonzero(known):
        seen = landmarks.observed_landmark[observed[k]]
        p_cam = transform(inverse(T_nav_cam[k]), landmarks.p_world[seen])
        np.add.at(total, seen, transform(T_true_cam[k], scale * p_cam))
        np.add.at(count, seen, 1.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        return total / count[:, None]


def true_cameras(navigation: Navigation, truth: Truth) -> FloatArray:
    """(F, 4, 4) true poses of the keyframes' cameras, NaN where none was recorded near in time."""
    camera = navigation.calibration.camera
    if camera is None:
        return truth_at(truth, navigation.keyframes.t_robot_ns)
    # Truth is stamped by the IMU's clock, keyframes by the camera's. A truth without IMU is of the camera itself:
    # then T_body_cam is the identity and the shift zero.
    t_imu_ns = navigation.keyframes.t_robot_ns + round(1e9 * camera.time_shift_s)
    return truth_at(truth, t_imu_ns) @ camera.T_body_cam_matrix


def truth_at(truth: Truth, t_robot_ns: IntArray) -> FloatArray:
    """(F, 4, 4) the true pose nearest in time, NaN where none is near."""
    after = np.clip(np.searchsorted(truth.t_robot_ns, t_robot_ns), 1, max(len(truth) - 1, 1))
    before = after - 1
    after = np.minimum(after, len(truth) - 1)
    nearer = np.abs(truth.t_robot_ns[after] - t_robot_ns) < np.abs(truth.t_robot_ns[before] - t_robot_ns)
    index = np.where(nearer, after, before)
    T = truth.T_world_body[index].copy()
    T[np.abs(truth.t_robot_ns[index] - t_robot_ns) > MAX_GAP_NS] = np.nan
    return T


def shared_rand_index(
    p_map: FloatArray, places: Sequence[Place], p_nav: FloatArray, label_nav: IntArray
) -> float | None:
    """Adjusted Rand index of two clusterings on the landmarks that lie beside one of the other navigation.

    `label_nav` are the second navigation's own clusters: not cut and joined with the map's help.
    """
    if not places or not (label_nav >= 0).any():
        return None
    from sklearn.metrics import adjusted_rand_score

    a, b = labels_of(places, len(p_map)), label_nav
    reach = SHARED_SHARE * float(np.median([_size(place, p_map) for place in places]))
    indices = []
    for p, label, q, other in ((p_nav, b, p_map, a), (p_map, a, p_nav, b)):
        ok_p, ok_q = np.flatnonzero(np.isfinite(p[:, 0]) & (label >= 0)), np.flatnonzero(np.isfinite(q[:, 0]))
        distance, nearest = cKDTree(q[ok_q]).query(p[ok_p])
        theirs = other[ok_q[nearest]]
        shared = (distance <= reach) & (theirs >= 0)
        if np.count_nonzero(shared) < 2:
            return None
        indices.append(float(adjusted_rand_score(theirs[shared], label[ok_p][shared])))
    return float(np.mean(indices))


def labels_of(places: Sequence[Place], count: int) -> IntArray:
    """(count,) which place each landmark belongs to, -1 for none."""
    label = np.full(count, -1, dtype=np.int64)
    for k, place in enumerate(places):
        label[place.landmark_index] = k
    return label


def count_duplicates(places: Sequence[Place], p_true: FloatArray) -> int:
    """Places whose true centroid lies inside another, larger place's half extent: one real place, named twice."""
    sizes = [_size(place, p_true) for place in places]
    centroids = [np.nanmean(p_true[place.landmark_index], axis=0) for place in places]
    duplicates: set[int] = set()
    for a, b in itertools.combinations(range(len(places)), 2):
        if np.linalg.norm(centroids[a] - centroids[b]) < 0.5 * max(sizes[a], sizes[b]):
            duplicates.add(a if sizes[a] <= sizes[b] else b)
    return len(duplicates)


def _judge(match: PlaceMatch, p_place: FloatArray, p_location: FloatArray) -> JudgedMatch:
    p_place, p_location = p_place[np.isfinite(p_place[:, 0])], p_location[np.isfinite(p_location[:, 0])]
    if not len(p_place) or not len(p_location):
        return JudgedMatch(match, float("nan"), float("nan"), correct=False)
    distance = float(np.linalg.norm(p_place.mean(axis=0) - p_location.mean(axis=0)))
    limit = half_extent(p_place)
    return JudgedMatch(match, distance, limit, correct=distance <= limit)


def co_visible_places(
    places: Sequence[Place], p_map: FloatArray, navigation: Navigation, truth: Truth, p_nav: FloatArray
) -> tuple[str, ...]:
    """Ids of the places that a navigation saw again, by true poses: in view, and something was reconstructed there.

    In view: half of the place's landmarks lie in three or more of its images, nearer than twice its viewing distance.
    Walls are not asked whether they hide a place, so some landmarks of the navigation must lie within its extent.
    """
    camera = navigation.calibration.camera
    seen = p_nav[np.isfinite(p_nav[:, 0])]
    if camera is None or not len(seen) or not places:
        return ()
    T_cam_world = inverse(true_cameras(navigation, truth))
    T_cam_world = T_cam_world[np.isfinite(T_cam_world[:, 0, 0])]
    distances = [np.linalg.norm(seen - T[:3, 3], axis=1) for T in inverse(T_cam_world)]
    reach = MAX_VIEW_SHARE * float(np.median(np.min(distances, axis=0)))
    views = np.zeros(len(p_map), dtype=np.int64)
    for T in T_cam_world:
        p = transform(T, np.nan_to_num(p_map, nan=1e9))
        u = camera.fx * p[:, 0] / np.maximum(p[:, 2], 1e-6) + camera.cx
        v = camera.fy * p[:, 1] / np.maximum(p[:, 2], 1e-6) + camera.cy
        views += (
            (p[:, 2] > 0) & (np.linalg.norm(p, axis=1) < reach)
            & (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
        )  # fmt: skip
    tree = cKDTree(seen)
    ids = []
    for place in places:
        in_view = (views[place.landmark_index] >= MIN_VIEWS).mean() >= CO_VISIBLE_SHARE
        p = p_map[place.landmark_index]
        centre = np.nanmean(p, axis=0)
        if in_view and len(tree.query_ball_point(centre, _size(place, p_map))) >= MIN_LANDMARKS:
            ids.append(place.id)
    return tuple(ids)


def _size(place: Place, p_true: FloatArray) -> float:
    p = p_true[place.landmark_index]
    return half_extent(p[np.isfinite(p[:, 0])])


def _registration_error(
    first: Navigation, p_map: FloatArray, second: Navigation, p_nav: FloatArray, result: MatchResult
) -> float | None:
    """Median distance between where the navigation's landmarks are carried to and where they truly are."""
    T = result.registration.T_target_source
    if T is None or not result.registration.accepted:
        return None
    ok = np.isfinite(p_map[:, 0])
    to_true = align_points(p_map[ok], first.landmarks.p_world[ok], "sim3").T_target_source
    good = np.isfinite(p_nav[:, 0])
    carried = transform(to_true @ T, second.landmarks.p_world[good])
    return float(np.median(np.linalg.norm(carried - p_nav[good], axis=1)))
