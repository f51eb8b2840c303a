"""Lengths and directions that a navigation brings with it, so that nobody has to set them."""

from __future__ import annotations

import numpy as np

from shared.geometry import FloatArray, median_radius, upright
from station.model.navigation import Navigation

WITHIN = 90.0  # per cent of the landmarks: single stragglers do not make a place larger
USUAL_VIEWING_M = 2.0  # how far cameras in homes see, for maps whose scale nobody knows
UP_PRIOR = 0.02  # weight of the cameras' mean up against their lack of roll


def viewing_distance(navigation: Navigation) -> float | None:
    """Median distance between cameras and the landmarks they see, in map units; None without a finite landmark.

    The one length that does not grow with the map, changes with its scale, and is alike on two drives of one home.
    Median over keyframes of each keyframe's median, so that a long stop in front of a shelf counts once per frame.
    """
    landmarks, keyframes = navigation.landmarks, navigation.keyframes
    distance = observation_distances(navigation)
    medians = []
    for observed in landmarks.observations_by_keyframe(len(keyframes)):
        seen = distance[observed][np.isfinite(distance[observed])]
        if len(seen):
            medians.append(float(np.median(seen)))
    if medians and np.median(medians) > 0:
        return float(np.median(medians))
    finite = landmarks.p_world[np.isfinite(landmarks.p_world).all(axis=1)]
    if not len(finite):
        return None
    # Without observations: half the cloud's radius is about how far one stands from what one looks at in one room.
    radius = median_radius(finite)
    return radius if radius > 0 else None


def units_per_metre(navigation: Navigation) -> float:
    """Map units per metre; where nobody knows the scale, as if the navigation saw as far as cameras in homes do."""
    length = None if navigation.is_metric else viewing_distance(navigation)
    return 1.0 if length is None else length / USUAL_VIEWING_M


def observation_distances(navigation: Navigation) -> FloatArray:
    """(K,) distance between camera centre and landmark of every observation, map units."""
    landmarks = navigation.landmarks
    centres = navigation.keyframes.T_world_cam[:, :3, 3]
    if not len(landmarks.observed_landmark):
        return np.zeros(0)
    delta = landmarks.p_world[landmarks.observed_landmark] - centres[landmarks.observed_keyframe]
    return np.linalg.norm(delta, axis=1)


def ground_rotation(navigation: Navigation) -> FloatArray:
    """Rotation R_ground_map (3, 3) to axes whose z is up, the map's x axis at yaw 0.

    Identity where gravity is known. Elsewhere up is what the cameras' horizontal axes are most perpendicular to:
    people and robots hold cameras without roll on the whole, but look down. Good enough to draw and to give
    bearings, never used to estimate.
    """
    T = navigation.keyframes.T_world_cam
    if navigation.is_gravity_aligned or not len(T):
        return np.eye(3)
    right, mean_up = T[:, :3, 0], -T[:, :3, 1].mean(axis=0)
    # A drive that never turned leaves a circle of directions open: the mean of the cameras' up decides among them.
    M = right.T @ right / len(T) - UP_PRIOR * np.outer(mean_up, mean_up)
    z = np.linalg.eigh(M)[1][:, 0]
    return upright(z if z @ mean_up >= 0 else -z, np.eye(3))


def half_extent(p: FloatArray) -> float:
    """Radius about the centroid of points (n, 3) that holds 90 % of them: half the place's extent."""
    return float(np.percentile(np.linalg.norm(p - p.mean(axis=0), axis=1), WITHIN)) if len(p) else 0.0
