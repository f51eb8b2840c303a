"""Where no mapping camera looked: who carries a camera is told the place there, a robot on wheels is not."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from shared.calibration import Rig
from shared.geometry import FloatArray, se3, yaw_rotation
from station.model.place_answer import Localization, PlaceAnswer
from station.places.tracking.current import CurrentPlaceEstimator
from tests.support.places import CONFIG, R_BODY_CAM, SECOND
from tests.support.rooms import mapped, walls

EYE, TOWARDS = np.array([2.6, 3.2, 0.0]), np.radians(-150.0)  # beside all that the mapping drive saw


def recognised(t_ns: int, p_map: FloatArray, half_view_deg: float) -> Localization:
    """An image taken at EYE that recognised what it sees of the room."""
    d = p_map[:, :2] - EYE[:2]
    off = np.degrees(np.angle(np.exp(1j * (np.arctan2(d[:, 1], d[:, 0]) - TOWARDS))))
    landmarks = np.flatnonzero((np.abs(off) < half_view_deg) & (p_map[:, 0] < 4.0))
    T = se3(yaw_rotation(TOWARDS), EYE) @ se3(R_BODY_CAM, np.zeros(3))
    return Localization(t_ns, T, len(landmarks), 0.8, 0.03, 4, "map", 1.0, 500, landmarks)


def asked(rig: Rig, half_view_deg: float) -> PlaceAnswer:
    """After three such images, of a map that was driven along the room's middle."""
    x = np.linspace(0.3, 1.2, 20)
    place_map = mapped(np.column_stack([x, np.full(20, 2.0)]), np.zeros(20), walls())
    calibration = msgspec.structs.replace(place_map.navigation.calibration, rig=rig)
    estimator = CurrentPlaceEstimator([place_map], calibration, CONFIG)
    for k in range(3):
        estimator.on_candidates([recognised(k * SECOND, walls(), half_view_deg)])
    return estimator.answer(2 * SECOND)


@pytest.mark.parametrize(("rig", "state"), [("hand-held", "known"), ("wheels", "unknown")])
def test_a_hand_held_camera_among_what_it_recognises_knows_its_place(rig: Rig, state: str) -> None:
    answer = asked(rig, 45.0)
    assert answer.state == state
    assert answer.position_map is not None and np.allclose(answer.position_map[:2], EYE[:2], atol=0.05)


def test_of_a_narrow_look_the_place_stays_unknown() -> None:
    assert asked("hand-held", 8.0).state == "unknown"
