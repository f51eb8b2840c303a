"""Where in the map was this image taken: appearance proposes keyframes, geometry verifies a pose, or says no.

An answer is a verified camera pose. Several maps can be active: each proposes keyframes by its own index, a pose is
estimated within one map only, and the poses of all of them stand against each other. docs/localisation.md has the
measurements behind the thresholds.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from shared.calibration import Calibration, CameraCalibration
from shared.errors import ConfigError
from shared.geometry import FloatArray, IntArray, rotation_angle
from station.model.best_camera import best_camera
from station.model.calibration_fit import CalibrationFit
from station.model.frames import ImageArray, ImageFrame
from station.model.place_answer import Localization
from station.model.place_map import PlaceMap
from station.places.localisation.keyframe_features import KeyframeFeatures, describe_keyframes
from station.places.localisation.map_index import MapIndex
from station.places.localisation.region_pose import FoundPose, MatchingConfig, find_pose
from station.vision.appearance import AppearanceIndex
from station.vision.features import FeatureExtractor, Features, extract_encoded, to_rays


@dataclass(frozen=True, slots=True)
class LocalizerConfig:
    """Thresholds; pixels are of the query image."""

    num_proposals: int = 16  # keyframes taken from the appearance index of each map
    max_groups: int = 3  # regions of each map that geometry is tried on
    group_size: int = 6  # keyframes matched together
    min_shared: int = 10  # landmarks that keyframes of one region share,
    min_shared_ratio: float = 0.25  # ... or so large a share of the landmarks of the one that shows fewer
    matching: MatchingConfig = field(default_factory=MatchingConfig)
    min_inliers: int = 10  # the belief weighs a pose by how many there are
    min_inlier_ratio: float = 0.3  # of the guided matches
    min_cells: int = 6  # of 8 x 6 image cells that hold an inlier: one poster is no room
    max_sigma: float = 0.25  # position uncertainty, as a share of the inliers' median depth
    max_rival: float = 0.6  # inliers of another pose, as a share of the best one's
    min_support: float = 0.08  # share of the landmarks that should be in view and were found


@dataclass(frozen=True, slots=True, eq=False)
class _Keyframe:
    """Where one indexed image belongs."""

    map_index: int
    keyframe_index: int
    features: KeyframeFeatures
    T_map_cam: FloatArray  # (4, 4)


@dataclass(frozen=True, slots=True, eq=False)
class Attempt:
    """What one image gave, also when it was no answer."""

    localization: Localization | None  # the pose, where only one explains the image
    candidates: tuple[Localization, ...]  # every verified pose, the best first: look-alikes give several
    reason: str  # why not, in a sentence; or what speaks for it
    num_features: int
    best_inliers: int
    similarity: float  # of the best keyframe's appearance, 0..1
    features: Features | None = None  # of the image


class Localizer:
    """Answers images from one or several maps. Not thread-safe: one per worker."""

    def __init__(
        self,
        maps: Sequence[PlaceMap],
        config: LocalizerConfig | None = None,
        described: Sequence[Sequence[KeyframeFeatures]] | None = None,
        index: Sequence[MapIndex] | None = None,
    ) -> None:
        """Describe and index all keyframes of the maps: some 100 ms per keyframe on one core.

        `described`: the features of every map's keyframes, where they are known already; `index`: of every map.
        """
        self.maps = tuple(maps)
        self.config = config or LocalizerConfig()
        self._extractors: dict[float | None, FeatureExtractor] = {}  # by which way is up
        self._is_upright = [_up_in(one) is not None for one in self.maps]
        if index is None:
            if described is None:
                described = [describe_keyframes(one, partial(self._describe, up_deg=_up_in(one))) for one in self.maps]
            index = [MapIndex.of_keyframes(keyframes) for keyframes in described]
        self.appearances = tuple(one.appearance for one in index)
        self.tried = tuple(one.tried for one in index)
        self._keyframes: list[_Keyframe] = []
        self._first: list[int] = []  # of each map's keyframes
        for m, (place_map, one) in enumerate(zip(self.maps, index, strict=True)):
            self._first.append(len(self._keyframes))
            poses = place_map.navigation.keyframes.T_world_cam
            self._keyframes += [_Keyframe(m, k, features, poses[k]) for k, features in enumerate(one.keyframes)]
        self._views = [_Views(self._keyframes, m) for m in range(len(self.maps))]

    def _describe(self, encoded: bytes, up_deg: float | None) -> Features:
        return extract_encoded(encoded, self._extractor(up_deg))

    def _extractor(self, up_deg: float | None) -> FeatureExtractor:
        if up_deg not in self._extractors:
            self._extractors[up_deg] = FeatureExtractor(up_deg=up_deg)
        return self._extractors[up_deg]

    def _features_for_maps(self, grey: ImageArray, calibration: Calibration) -> list[Features]:
        """Of an image, for each map as its pictures were described: turned as the rig that mapped it knew to turn."""
        up_deg = {False: None, True: calibration.up_in_image_deg or 0.0}  # by hand a camera is held upright, too
        by_kind = {kind: self._extractor(up_deg[kind]).extract(grey) for kind in set(self._is_upright)}
        return [by_kind[kind] for kind in self._is_upright]

    def localize(self, frame: ImageFrame, calibration: Calibration) -> Localization | None:
        """A verified pose, or None. Raises DataError for an undecodable image, ConfigError without a camera."""
        return self.attempt(frame, calibration).localization

    def attempt(self, frame: ImageFrame, calibration: Calibration, fit: CalibrationFit | None = None) -> Attempt:
        """A verified pose and the reason, or why there is none. Raises as `localize` does.

        `fit`: what the robot's drive so far says of its calibration.
        """
        camera = calibration.camera
        if camera is None:
            raise ConfigError("calibration has no camera; localisation needs one")
        return self.attempt_features(self._features_for_maps(frame.grey(), calibration), frame.t_robot_ns, camera, fit)

    def attempt_features(
        self,
        features: Sequence[Features],
        t_robot_ns: int,
        told: CameraCalibration,
        fit: CalibrationFit | None = None,
        left_out: Collection[int] = (),
    ) -> Attempt:
        """As `attempt`, from the features of an image for each map; `left_out`: keyframes that are not matched."""
        seen = features[0]  # always the same map's: whoever compares images has features of one kind
        n = max(map(len, features))
        if n < self.config.min_inliers:
            return _nothing(f"only {n} features in the image: dark, covered, blurred or featureless", seen)
        proposed = [self._propose(index, one, left_out) for index, one in zip(self.appearances, features, strict=True)]
        if not any(len(images) for images, _ in proposed):
            return _nothing("nothing in the map resembles the image", seen)
        cameras = [best_camera(told, one.navigation, fit) for one in self.maps]
        poses = []
        # Similarities by the words of different maps cannot be compared (a small map has few words, which more images
        # share), so that they must not compete for being tried.
        for m, (first, (images, _)) in enumerate(zip(self._first, proposed, strict=True)):
            rays = to_rays(cameras[m], features[m].uv_px)
            for group in self._groups(first + images):
                members = [self._keyframes[i].features for i in group]
                pose = find_pose(m, members, features[m], rays, cameras[m], self.config.matching)
                if pose is not None:
                    poses.append(pose)
        best_similarity = max(float(similarity[0]) for _, similarity in proposed if len(similarity))
        if not poses:
            return _nothing("no keyframe that resembles the image agrees with it in space", seen, best_similarity)
        poses = self._distinct(poses)
        best_inliers = poses[0].pose.num_inliers
        objections = [self._objection(pose, features[pose.map_index], cameras[pose.map_index]) for pose in poses]
        verified = [pose for pose, objection in zip(poses, objections, strict=True) if objection is None]
        candidates = tuple(self._answer(pose, len(features[pose.map_index]), t_robot_ns) for pose in verified)
        if not candidates:
            return Attempt(None, (), objections[0] or "", n, best_inliers, best_similarity, seen)
        rival = self._rival(verified[0], poses)
        if rival is None:
            return Attempt(
                candidates[0],
                candidates,
                f"{verified[0].pose.num_inliers} landmarks of the map found where they belong",
                n,
                best_inliers,
                best_similarity,
                seen,
            )
        reason = f"another part of the map fits as well ({rival} against {verified[0].pose.num_inliers} landmarks)"
        return Attempt(None, candidates, reason, n, best_inliers, best_similarity, seen)

    def _propose(
        self, index: AppearanceIndex, features: Features, left_out: Collection[int]
    ) -> tuple[IntArray, FloatArray]:
        """Keyframes of a map that look most like an image, and how much."""
        images, similarity = index.query(features.descriptors, self.config.num_proposals + len(left_out))
        kept = np.flatnonzero([i not in left_out for i in images.tolist()])[: self.config.num_proposals]
        return images[kept], similarity[kept]

    def _groups(self, images: IntArray) -> list[list[int]]:
        """Proposed keyframes of one map by region: each of the best ones with those that share landmarks with it."""
        left = [int(i) for i in images]
        groups: list[list[int]] = []
        while left and len(groups) < self.config.max_groups:
            lead = left.pop(0)
            mine = set(self._keyframes[lead].features.landmark.tolist())
            group = [lead]
            for i in list(left):
                if len(group) == self.config.group_size:
                    break
                if self._is_same_region(mine, set(self._keyframes[i].features.landmark.tolist())):
                    group.append(i)
                    left.remove(i)
            groups.append(group)
        return groups

    def _is_same_region(self, a: set[int], b: set[int]) -> bool:
        c, shared = self.config, len(a & b)
        return shared >= c.min_shared or 0 < c.min_shared_ratio * min(len(a), len(b)) <= shared

    def _distinct(self, poses: list[FoundPose]) -> list[FoundPose]:
        """The poses by their inliers; of those that say the same, the best one."""
        out: list[FoundPose] = []
        for found in sorted(poses, key=lambda p: -p.pose.num_inliers):
            if all(self._differ(found, other) for other in out):
                out.append(found)
        return out

    def _rival(self, best: FoundPose, poses: list[FoundPose]) -> int | None:
        """Inliers of another pose that explains the image nearly as well; None when there is none."""
        enough = self.config.max_rival * best.pose.num_inliers
        return next((p.pose.num_inliers for p in poses if p is not best and p.pose.num_inliers > enough), None)

    def _objection(self, best: FoundPose, features: Features, camera: CameraCalibration) -> str | None:
        """Why a pose may not be believed; None when it may."""
        c = self.config
        pose = best.pose
        n = pose.num_inliers
        if n < c.min_inliers:
            return f"only {n} landmarks agree on a pose, needs {c.min_inliers}"
        if n < c.min_inlier_ratio * best.num_matches:
            return f"only {n} of {best.num_matches} matches agree on a pose"
        cells = np.floor(features.uv_px[best.query] / np.array([camera.width / 8, camera.height / 6])).astype(int)
        if len(np.unique(cells[:, 0] + 100 * cells[:, 1])) < c.min_cells:
            return "the landmarks found sit in one corner of the image"
        depth = pose.median_depth
        if pose.sigma_position > c.max_sigma * depth:
            return f"the position is only known to {pose.sigma_position:.2f} at {depth:.1f} depth"
        support = self._support(best, camera)
        if support < c.min_support:
            return f"only {support:.0%} of the landmarks that should be in view are there"
        return None

    def _differ(self, a: FoundPose, b: FoundPose) -> bool:
        gap = 0.3 * max(a.pose.median_depth, b.pose.median_depth)
        if a.map_index != b.map_index:
            return True
        A, B = a.pose.T_map_cam, b.pose.T_map_cam
        angle = rotation_angle(A[:3, :3].T @ B[:3, :3])
        return bool(np.linalg.norm(A[:3, 3] - B[:3, 3]) > gap or angle > np.radians(15.0))

    def _support(self, found: FoundPose, camera: CameraCalibration) -> float:
        """Share found of the landmarks that should be in view: in the likest keyframes, and inside the image."""
        views = np.unique(self._views[found.map_index].of(found.landmark))
        if not len(views):
            return 0.0
        T = found.pose.T_map_cam
        facing = [float(self._keyframes[v].T_map_cam[:3, 2] @ T[:3, 2]) for v in views]
        nearest = views[np.argsort(facing)[::-1][:4]]
        p = np.concatenate([self._keyframes[v].features.p_map for v in nearest])
        ids = np.concatenate([self._keyframes[v].features.landmark for v in nearest])
        _, first = np.unique(ids, return_index=True)
        p_cam = (p[first] - T[:3, 3]) @ T[:3, :3]
        ahead = p_cam[:, 2] > 0.1 * found.pose.median_depth
        xy = p_cam[:, :2] / np.where(ahead, p_cam[:, 2], 1.0)[:, None]
        half = np.array([camera.width / camera.fx, camera.height / camera.fy]) / 2
        in_view = ahead & (np.abs(xy) < 0.95 * half).all(axis=1)
        return len(np.unique(found.landmark)) / max(1, int(np.count_nonzero(in_view)))

    def _answer(self, found: FoundPose, num_features: int, t_robot_ns: int) -> Localization:
        likest = int(np.argmax(np.bincount(self._views[found.map_index].of(found.landmark))))
        return Localization(
            t_robot_ns=t_robot_ns,
            T_map_cam=found.pose.T_map_cam,
            num_inliers=found.pose.num_inliers,
            inlier_ratio=found.pose.num_inliers / found.num_matches,
            sigma_position=found.pose.sigma_position,
            keyframe_index=self._keyframes[likest].keyframe_index,
            map_id=self.maps[found.map_index].id,
            extent=found.extent,
            num_features=num_features,
            landmarks=np.unique(found.landmark),
        )


def _up_in(place_map: PlaceMap) -> float | None:
    return place_map.navigation.calibration.up_in_image_deg


def _nothing(reason: str, features: Features, similarity: float = 0.0) -> Attempt:
    return Attempt(None, (), reason, len(features), 0, similarity, features)


class _Views:
    """Which indexed keyframes of one map show a landmark. Sorted arrays: a large map has millions of landmarks."""

    def __init__(self, keyframes: list[_Keyframe], map_index: int) -> None:
        ids, views = [np.zeros(0, dtype=np.int64)], [np.zeros(0, dtype=np.int64)]
        for number, keyframe in enumerate(keyframes):
            if keyframe.map_index == map_index:
                mine = np.unique(keyframe.features.landmark)
                ids.append(mine)
                views.append(np.full(len(mine), number, dtype=np.int64))
        landmark, view = np.concatenate(ids), np.concatenate(views)
        order = np.argsort(landmark, kind="stable")
        self._landmark, self._view = landmark[order], view[order]

    def of(self, landmark: IntArray) -> IntArray:
        """Numbers of the keyframes that show each of the landmarks (n,), one after the other."""
        begin = np.searchsorted(self._landmark, landmark, side="left")
        length = np.searchsorted(self._landmark, landmark, side="right") - begin
        at = np.repeat(begin - np.cumsum(length) + length, length) + np.arange(length.sum())
        return self._view[at]
