"""What the keyframes of a map saw and from where: so much should be in view of a camera at a pose."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from shared.calibration import CameraCalibration
from shared.geometry import FloatArray, IntArray
from station.model.place_map import PlaceMap
from station.places.localisation.keyframe_features import LANDMARK_ANGLE_RAD
from station.places.space.space import Space

# Far smaller or larger a landmark does not look like itself, nor from another side (LANDMARK_ANGLE_RAD).
LANDMARK_ZOOM = 2.0
LANDMARK_REACH = 2.5  # m around a position in which keyframes are asked what they saw
MOST_ASKED = 400  # of those, for one image: 4000 (a room driven through all day) would take 0.1 s for each hypothesis
HIDDEN_M = 0.5  # behind other landmarks of one direction: not to be seen from here
HIDDEN_RAD = np.radians(10.0)
NEAREST_M = 0.05  # in front of the camera
THINNED_VIEW = 60  # landmarks of a keyframe that are looked at


class Sightings:
    """Of one map."""

    def __init__(self, place_map: PlaceMap, unit: float, space: Space) -> None:
        """`unit`: map units per metre."""
        self._unit = unit
        self._space = space
        navigation = place_map.navigation
        poses = navigation.keyframes.T_world_cam
        self._position = poses[:, :3, 3]
        self._tree = cKDTree(self._position) if len(poses) else None
        self._shuffled = np.random.default_rng(0).permutation(len(poses))
        self._seen = _Seen(place_map)

    @property
    def is_enough(self) -> bool:
        """Whether the map says what its keyframes saw, so that what should be in view can be counted."""
        return self._seen.is_enough

    def in_view(self, T_map_cam: FloatArray, camera: CameraCalibration) -> float:
        """How many landmarks a camera may recognise at this pose (4, 4)."""
        return float(len(self._p_in_view(T_map_cam, camera)) * self._seen.every)

    def surely_in_view(self, T_map_cam: FloatArray, camera: CameraCalibration) -> float:
        """How many of them can be seen through what the map knows to be free: none through a cupboard."""
        shown = self._space.shows(T_map_cam[:3, 3], self._p_in_view(T_map_cam, camera))
        return float(np.count_nonzero(shown) * self._seen.every)

    def _p_in_view(self, T_map_cam: FloatArray, camera: CameraCalibration) -> FloatArray:
        """(n, 3) of the landmarks that are kept, in the map."""
        eye = T_map_cam[:3, 3]
        if self._tree is None:
            return np.zeros((0, 3))
        near = np.array(self._tree.query_ball_point(eye, LANDMARK_REACH * self._unit), dtype=np.int64)
        if not len(near):
            return np.zeros((0, 3))
        if len(near) > MOST_ASKED:  # not every n-th one: drives repeat themselves
            near = near[np.argsort(self._shuffled[near])[:MOST_ASKED]]
        d = self._known_from(eye, near)
        d = d[d @ T_map_cam[:3, 2] > NEAREST_M * self._unit]
        p_cam = d @ T_map_cam[:3, :3]
        right = camera.fx * p_cam[:, 0] / p_cam[:, 2] + camera.cx
        down = camera.fy * p_cam[:, 1] / p_cam[:, 2] + camera.cy
        inside = (right >= 0) & (right < camera.width) & (down >= 0) & (down < camera.height)
        return np.asarray(eye + d[inside])

    def _known_from(self, eye: FloatArray, near: IntArray) -> FloatArray:
        """(n, 3) from a position (3,) to the landmarks that these keyframes (k,) saw and that look alike from there."""
        landmark, keyframe = self._seen.by(near)
        then = self._seen.p_map[landmark] - self._position[keyframe]
        now = self._seen.p_map[landmark] - eye
        far_then, far_now = np.linalg.norm(then, axis=1), np.linalg.norm(now, axis=1)
        alike = np.einsum("ni,ni->n", then, now) > np.cos(LANDMARK_ANGLE_RAD) * far_then * far_now
        alike &= (far_now < LANDMARK_ZOOM * far_then) & (far_then < LANDMARK_ZOOM * far_now)
        alike &= ~_hidden(landmark, now, far_now, HIDDEN_M * self._unit)
        _, once = np.unique(landmark[alike], return_index=True)
        return np.asarray(now[alike][once])


def _hidden(landmark: IntArray, d: FloatArray, far: FloatArray, margin: float) -> npt.NDArray[np.bool_]:
    """(n,) whether other landmarks stand in front of these, that lie at d (n, 3), `far` away: a wall, from behind."""
    _, once = np.unique(landmark, return_index=True)
    azimuth = np.arctan2(d[:, 1], d[:, 0])
    elevation = np.arcsin(np.clip(d[:, 2] / np.maximum(far, 1e-9), -1, 1))
    cell = np.floor(azimuth / HIDDEN_RAD).astype(np.int64) * 1000 + np.floor(elevation / HIDDEN_RAD).astype(np.int64)
    order = once[np.lexsort((far[once], cell[once]))]
    cells, begin = np.unique(cell[order], return_index=True)
    # The second nearest of a direction: one landmark may be false.
    second = np.minimum(begin + 1, np.append(begin[1:], len(order)) - 1)
    return np.asarray(far > far[order[second]][np.searchsorted(cells, cell)] + margin, dtype=np.bool_)


class _Seen:
    """Which landmarks each keyframe saw, of a share of them that is enough to judge views by."""

    def __init__(self, place_map: PlaceMap) -> None:
        landmarks = place_map.navigation.landmarks
        count = len(place_map.navigation.keyframes)
        every = max(1, len(landmarks.observed_landmark) // max(1, THINNED_VIEW * count))
        somewhere = np.asarray(np.isfinite(landmarks.p_world).all(axis=1), dtype=np.bool_)
        kept = (landmarks.observed_landmark % every == 0) & somewhere[landmarks.observed_landmark]
        self.p_map = landmarks.p_world
        self._landmarks = [
            landmarks.observed_landmark[observed[kept[observed]]]
            for observed in landmarks.observations_by_keyframe(count)
        ]
        self.every = every  # one of so many landmarks is among those kept
        # Whether a usual keyframe saw anything to speak of.
        self.is_enough = count > 0 and float(np.median([len(seen) for seen in self._landmarks])) >= 10

    def by(self, keyframes: IntArray) -> tuple[IntArray, IntArray]:
        """Every (landmark, keyframe) that these keyframes (k,) saw: arrays (n,), (n,)."""
        seen = [self._landmarks[k] for k in keyframes]
        return np.concatenate(seen), np.repeat(keyframes, [len(landmarks) for landmarks in seen])
