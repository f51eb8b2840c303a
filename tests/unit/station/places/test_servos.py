"""Servos of the camera's head learned from recognised images: of a head that errs as hobby servos do."""

from __future__ import annotations

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from shared.calibration import REFERENCE_HEAD, REFERENCE_ROBOT, Calibration
from shared.geometry import FloatArray, rotation_angle, se3, yaw_rotation
from shared.head import turned
from station.model.calibration_fit import CalibrationFit
from station.model.frames import DriveSample, ImageFrame, ImuBatch
from station.model.place_map import PlaceMap
from station.motion.head import AHEAD
from station.places.localisation.localizer import Attempt, Localizer
from station.places.tracking.config import BeliefConfig
from station.places.tracking.servos import MOST_REFUSED, ServoLearner, SureView
from station.places.tracking.tracker import PlaceTracker
from tests.support.places import R_BODY_CAM, SECOND, make_map, pose, seen

SIGMA_RAD = np.radians(2.0)
EVERY_NS = SECOND // 4


def error(pan: float) -> float:
    """Of a servo that turns a tenth too far: 6 degrees at 60."""
    return 0.1 * pan


def swept(k: int) -> float:
    """Told pan of the k-th image: from side to side, at 40 degrees a second."""
    return float(np.radians(60.0) * (abs((k * 10 + 60) % 240 - 120) / 60 - 1))


class Head:
    """What it is told, and a view of it now and then; the body stands at a heading, and odometry began at another."""

    def __init__(self) -> None:
        self.learner = ServoLearner(REFERENCE_HEAD, BeliefConfig())
        self.t_ns = 0

    def tell(self, pan: float) -> None:
        """It rests there when an image is taken a second later."""
        self.learner.on_drive(DriveSample(self.t_ns, 0.0, 0.0, pan, 0.0))
        self.t_ns += SECOND
        self.learner.on_drive(DriveSample(self.t_ns, 0.0, 0.0, pan, 0.0))

    def off(self, pan: float) -> float:
        """How far the aim is from where the head looks, rad."""
        self.tell(pan)
        aim = self.learner.aim(self.t_ns)
        return rotation_angle(aim.T_body_head[:3, :3].T @ turned(REFERENCE_HEAD, pan + error(pan), 0.0)[:3, :3])

    def sigma(self, pan: float) -> float:
        self.tell(pan)
        return self.learner.aim(self.t_ns).sigma_rad

    def look(self, pan: float, heading: float = 0.3, nav: float = -1.2, frame: tuple[int, int] = (1, 0)) -> None:
        """An image that shows the truth, of a body with this heading in the map, and another one by odometry."""
        self.tell(pan)
        self.learner.aim(self.t_ns)
        R_map_head = yaw_rotation(heading) @ turned(REFERENCE_HEAD, pan + error(pan), 0.0)[:3, :3]
        self.learner.learn(SureView(R_map_head, SIGMA_RAD, yaw_rotation(heading + nav), frame))


def test_servos_are_learned_while_the_head_looks_around() -> None:
    head = Head()
    aside = np.radians([-60.0, -35.0, 45.0, 60.0])
    before, unsure = [head.off(pan) for pan in aside], head.sigma(1.0)
    for k in range(96):
        head.look(swept(k), heading=0.02 * k)
    after, sure = [head.off(pan) for pan in aside], head.sigma(1.0)
    assert np.degrees(max(before)) > 5.5
    assert np.degrees(max(after)) < 1.0
    assert sure < 0.5 * unsure


def test_a_head_that_only_looks_to_one_side_teaches_nothing_of_its_servo() -> None:
    """By an image with the head aside the heading is as wrong as the servo, and every later one agrees."""
    head, pan = Head(), float(np.radians(50.0))
    head.look(pan)
    unsure = head.sigma(pan)
    for _ in range(40):
        head.look(pan)
    assert head.sigma(pan) > 0.9 * unsure
    assert np.degrees(head.off(pan)) > 4.0


def test_a_heading_that_jumped_is_no_servo_that_jumped() -> None:
    head, pan = Head(), float(np.radians(60.0))
    for k in range(96):
        head.look(swept(k))
    for k in range(MOST_REFUSED + 24):  # another hypothesis by the frame it tells, then one that does not tell
        head.look(swept(k), heading=1.5, nav=0.4, frame=(2, 0))
    for k in range(MOST_REFUSED + 24):
        head.look(swept(k), heading=-1.0, nav=2.0, frame=(2, 0))
    assert np.degrees(head.off(pan)) < 1.0
    assert head.learner._refused == 0


def test_a_head_that_was_never_turned_looks_ahead() -> None:
    head = Head()
    head.tell(0.0)
    assert head.learner.aim(head.t_ns) is AHEAD
    head.learner.learn(SureView(np.eye(3), SIGMA_RAD, np.eye(3), (1, 0)))
    assert head.learner.aim(head.t_ns) is AHEAD
    fixed = ServoLearner(None, BeliefConfig())
    fixed.on_drive(DriveSample(0, 0.0, 0.0, 1.0, 0.0))
    assert fixed.aim(0) is AHEAD


class Recognises(Localizer):
    """Finds every image where a robot that stands at (2.8, 0.2) has its head."""

    def __init__(self, place_map: PlaceMap) -> None:
        super().__init__([place_map])
        self.T_map_head: FloatArray = np.eye(4)

    def attempt(self, frame: ImageFrame, calibration: Calibration, fit: CalibrationFit | None = None) -> Attempt:
        T_map_cam = self.T_map_head @ se3(R_BODY_CAM, np.zeros(3))
        found = replace(seen(frame.t_robot_ns / 1e9, np.eye(4)), T_map_cam=T_map_cam)
        return Attempt(found, (found,), "", 500, 200, 0.5)


@pytest.mark.parametrize("pan_to", [1.0, -0.9])
def test_the_robots_heading_is_right_once_its_head_has_looked_around(pan_to: float) -> None:
    place_map = make_map()
    camera = place_map.navigation.calibration.camera
    assert camera is not None
    localizer = Recognises(place_map)
    tracker = PlaceTracker([place_map], msgspec.structs.replace(REFERENCE_ROBOT, camera=camera), localizer)
    T_map_body, told = pose(2.8, 0.2, 0.4), 0.0
    forwards = []
    for k in range(121):
        t = k * EVERY_NS + SECOND
        pan = swept(k) if k < 96 else pan_to
        tracker.on_imu(at_rest(t))
        tracker.on_drive(DriveSample(t - EVERY_NS // 2, 0.0, 0.0, told, 0.0))
        tracker.on_drive(DriveSample(t - EVERY_NS // 4, 0.0, 0.0, pan, 0.0))
        told = pan
        localizer.T_map_head = T_map_body @ turned(REFERENCE_HEAD, pan + error(pan), 0.0)
        tracker.on_frame(ImageFrame(k, t, 0, b""))
        forwards.append(tracker.answer(t).forward_map)
    last = forwards[-1]
    assert last is not None
    assert abs(np.degrees(np.arctan2(last[1], last[0]) - 0.4)) < 1.0  # 5 degrees and more without


def at_rest(t_ns: int) -> ImuBatch:
    return ImuBatch(np.array([t_ns]), np.zeros((1, 3)), np.array([[0.0, 0.0, 9.81]]))
