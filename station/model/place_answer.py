"""What localisation says: where one image was taken in a map, and which place the robot is at now."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from shared.geometry import FloatArray, IntArray

PlaceState = Literal["known", "unknown", "lost"]


@dataclass(frozen=True, slots=True, eq=False)
class Localization:
    """One image, found in a map by geometry: verified, or it would not exist. Look-alikes may give it several."""

    t_robot_ns: int
    T_map_cam: FloatArray  # (4, 4)
    num_inliers: int
    inlier_ratio: float
    sigma_position: float  # map units, 1 sigma per axis
    keyframe_index: int  # the map's keyframe with the most inliers: the evidence image
    map_id: str
    extent: float  # map units: median distance of the recognised landmarks from their middle
    num_features: int  # of the image
    landmarks: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))  # (i,) of the map, recognised


@dataclass(frozen=True, slots=True)
class PlaceCandidate:
    """One place and how probable it is that the robot is nearest to it, ties within 10 % of the distance included.

    Near the border of two places both are right, so that the probabilities of several may sum to more than one.
    """

    id: str
    name: str
    probability: float


@dataclass(frozen=True, slots=True, eq=False)
class PlaceAnswer:
    """The current place. `place` is None unless state is "known"."""

    state: PlaceState
    place: PlaceCandidate | None
    distance: float | None  # robot to centroid, map units
    position_map: FloatArray | None  # (3,) the robot's body
    t_robot_ns: int  # sensor time the answer is about
    evidence_t_robot_ns: int | None  # sensor time of the last verified localisation
    evidence_keyframe: int | None
    inliers: int
    alternatives: tuple[PlaceCandidate, ...]
    reason: str  # a sentence for a person
    map_id: str | None = None  # of what is said of place, position and evidence; None: nothing speaks for any map
