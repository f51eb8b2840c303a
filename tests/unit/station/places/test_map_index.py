"""What the index of a map proposes, and which proposals are matched together."""

from __future__ import annotations

import numpy as np

from station.places.localisation.keyframe_features import KeyframeFeatures
from station.places.localisation.localizer import Localizer
from station.places.localisation.map_index import MapIndex
from tests.support.walls import make_map


def keyframe(number: int, landmarks: list[int]) -> KeyframeFeatures:
    """Shows 50 features of its own, of which the first lie on these landmarks."""
    descriptors = np.random.default_rng(number).integers(0, 90, (50, 128)).astype(np.uint8)
    n = len(landmarks)
    return KeyframeFeatures(descriptors[:n], np.ones((n, 3)), np.array(landmarks, dtype=np.int64), descriptors)


def test_a_keyframe_that_no_pose_can_rest_on_is_not_proposed() -> None:
    shown = [keyframe(0, list(range(20))), keyframe(1, [1, 2, 3, 4, 5]), keyframe(2, list(range(6)))]
    index = MapIndex.of_keyframes(shown)
    for number, is_proposed in ((0, True), (1, False), (2, True)):
        proposed, _ = index.appearance.query(shown[number].all_descriptors, 3)
        assert (number in proposed) == is_proposed


def test_a_region_of_few_landmarks_is_held_together_by_a_quarter_of_them() -> None:
    place_map = make_map("wall", 1)
    lead = list(range(12))
    others = [[*lead[:3], *range(20, 29)], [*lead[:2], *range(30, 40)], list(range(40, 140)), lead, [], [], []]
    shown = [keyframe(k, landmarks) for k, landmarks in enumerate([lead, *others][:7])]
    localizer = Localizer([place_map], index=[MapIndex.of_keyframes(shown)])
    assert localizer._groups(np.arange(5))[0] == [0, 1, 4]


def test_keyframes_of_many_landmarks_need_ten_in_common() -> None:
    place_map = make_map("wall", 1)
    lead = list(range(200))
    shown = [keyframe(0, lead[:50]), keyframe(1, lead[40:90]), keyframe(2, lead[41:91])]
    shown += [keyframe(k, []) for k in range(3, 7)]
    localizer = Localizer([place_map], index=[MapIndex.of_keyframes(shown)])
    assert localizer._groups(np.arange(3))[0] == [0, 1]
