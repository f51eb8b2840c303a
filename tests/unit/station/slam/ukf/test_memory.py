"""What stays of frames that leave the filter's window: keyframes, and views of turns on the spot."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from shared.calibration import REFERENCE_HEAD, REFERENCE_ROBOT
from shared.geometry import FloatArray, se3, so3_exp
from station.model.frames import ImageFrame
from station.motion.head import NUM_ERRORS, PAN_KNOTS, PLAY, HeadPose, HeadThen
from station.motion.preintegration import ImuSegment, Preintegration, preintegrate
from station.slam.ukf.filter.filter import RetiredClone
from station.slam.ukf.map.landmark_map import LandmarkQuality
from station.slam.ukf.map.views import MapViews, View, ViewConfig
from station.slam.ukf.memory import MOST_TURNED, NavigationMemory, RecentFrame
from station.vision.camera_model import CameraModel
from station.vision.klt import TrackedFrame

assert REFERENCE_ROBOT.camera is not None and REFERENCE_ROBOT.imu is not None
MODEL = CameraModel.of(REFERENCE_ROBOT.camera, 1.0)
FRAME_S = 0.25
BLANK = bytes(cv2.imencode(".png", np.full((480, 640), 128, dtype=np.uint8))[1].tobytes())
# The filter learns where the first pose was, after the frames of the turn have left.
CORRECTION = se3(so3_exp(np.array([0.0, 0.0, 0.1])), np.array([0.3, -0.2, 0.0]))


def turned_by(degrees: float) -> FloatArray:
    return se3(so3_exp(np.array([0.0, 0.0, np.radians(degrees)])), np.array([1.0, 2.0, 0.1]))


def one_frame_of_imu() -> Preintegration:
    assert REFERENCE_ROBOT.imu is not None
    n = round(FRAME_S / 0.005)
    imu = ImuSegment(np.full(n, 0.005), np.zeros((n, 3)), np.zeros((n, 3)), 0, np.zeros(3), np.ones((n, 6)))
    return preintegrate(imu, np.zeros(6), REFERENCE_ROBOT.imu)


def frame(number: int) -> RecentFrame:
    """Nothing in it is followed from frame to frame."""
    ids = 50 * number + np.arange(50)
    uv = np.random.default_rng(number).uniform(200, 400, (50, 2))
    t_ns = round(1e9 * FRAME_S * number)
    tracked = TrackedFrame(ids, uv, MODEL.lens.unproject(uv), 50, 100.0)
    link = one_frame_of_imu() if number else None
    return RecentFrame(ImageFrame(number, t_ns, 0, BLANK), tracked, t_ns, link, None, np.zeros((50, 3), np.uint8), None)


def state(clones: list[int], poses: list[FloatArray]) -> Any:
    return SimpleNamespace(
        clone_frame=np.array(clones),
        clone_R=np.array([poses[i][:3, :3] for i in clones]),
        clone_x=np.array([poses[i][:3, 3] for i in clones]),
        bias_gyro=np.zeros(3),
        bias_accel=np.zeros(3),
    )


def retired(number: int, T: FloatArray, is_keyframe: bool) -> RetiredClone:
    return RetiredClone(number, T, is_keyframe, np.zeros(3), np.zeros(3))


def turned_on_the_spot(degrees_a_frame: float, frames: int) -> tuple[NavigationMemory, list[View]]:
    """Only the first and the last frame become keyframes."""
    views = MapViews(MODEL.lens, ViewConfig(), 0)
    memory = NavigationMemory(MODEL, REFERENCE_ROBOT, LandmarkQuality(), 100, views)
    poses = [turned_by(degrees_a_frame * number) for number in range(frames)]
    last = frames - 1
    for number in range(2):
        memory.add(frame(number))
    for number in range(1, last):
        memory.add(frame(number + 1))
        memory.retire(retired(number, poses[number], False), state([0, number + 1], poses))
    better = [CORRECTION @ T for T in poses]
    memory.retire(retired(0, better[0], True), state([last], better))
    memory.retire(retired(last, better[last], True), state([], better))
    return memory, views.describe_all()[0]


@pytest.mark.parametrize(("degrees_a_frame", "expected"), [(5.0, [0, 1, 2, 3, 4, 5]), (2.0, [0, 2, 4, 5])])
def test_a_turn_on_the_spot_leaves_views_where_the_first_pose_turned_out_to_be(
    degrees_a_frame: float, expected: list[int]
) -> None:
    _, found = turned_on_the_spot(degrees_a_frame, 6)
    assert [view.frame_index for view in found] == expected
    for view in found:
        true = CORRECTION @ turned_by(degrees_a_frame * view.frame_index)
        assert np.allclose(view.keyframe.T_world_head, true)


def test_the_imu_reaches_from_view_to_view_and_from_keyframe_to_keyframe() -> None:
    memory, found = turned_on_the_spot(2.0, 6)
    durations = [view.keyframe.link.duration_s if view.keyframe.link else None for view in found]
    assert durations == [None, *np.diff([view.frame_index for view in found]) * FRAME_S]
    first, last = memory.keyframes.items
    assert first.link is None and last.link is not None
    assert last.link.duration_s == pytest.approx(5 * FRAME_S)


def test_a_robot_that_stands_or_turns_to_and_fro_for_long_leaves_a_few_views() -> None:
    assert len(turned_on_the_spot(0.0, 3 * MOST_TURNED)[1]) == 2
    assert len(turned_on_the_spot(5.0, 3 * MOST_TURNED)[1]) == MOST_TURNED + 2


def test_where_the_body_was_follows_what_has_been_learned_of_the_heads_servos_since() -> None:
    """They turned a tenth further than told, which nobody knew when the image was taken."""
    head = HeadPose(REFERENCE_HEAD, np.array([0.5, 0.0]), np.zeros(2), np.zeros(2))
    truly = head.T_body_head(np.array([0.05, 0.0]))
    memory = NavigationMemory(MODEL, REFERENCE_ROBOT, LandmarkQuality(), 100, None)
    memory.add(replace(frame(0), head=head, head_then=HeadThen(head, np.zeros(2))))
    memory.poses.add(0, 0, turned_by(-3.0), 0)
    learned = np.zeros(NUM_ERRORS)
    learned[PLAY], learned[2 : 2 + len(PAN_KNOTS)] = 0.02, 0.1 * PAN_KNOTS  # what play it has now is another
    after = state([], [turned_by(0.0)])
    after.head = learned
    memory.retire(retired(0, turned_by(0.0) @ truly, True), after)
    body = memory.poses.pose_of(0)
    assert body is not None and np.allclose(body, turned_by(0.0))
    T_body_head = memory.keyframes.items[0].T_body_head
    assert T_body_head is not None and np.allclose(T_body_head, truly)
