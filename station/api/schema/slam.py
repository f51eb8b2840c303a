"""SLAM of the navigation that is recorded."""

from __future__ import annotations

from typing import Literal

import numpy as np
from pydantic import Field

from station.api.schema.base import Model
from station.robots.session import RobotSession


class SlamModel(Model):
    """The running SLAM, or the last one."""

    navigation: str | None
    state: Literal["none", "initialising", "tracking", "lost", "finishing", "finished"]
    message: str = Field(examples=["not initialised yet: move the robot sideways"])
    landmarks: int
    frames: int
    t_robot_ns: int | None
    T_world_body: list[float] | None = Field(description="row-major 4x4; null while there is no pose")
    T_world_cam: list[float] | None = Field(description="the same for the camera")
    segment: int


class TrajectoryModel(Model):
    """Poses so far, oldest first; thinned to `limit` poses."""

    navigation: str | None
    source: str | None = Field(description="the cloud it belongs to: X-Source of GET /landmarks")
    total: int
    t_robot_ns: list[int]
    p_world: list[list[float]] = Field(description="body positions, (N, 3)")


def slam_model(robot: RobotSession) -> SlamModel:
    live = robot.current_navigation.live
    if live is None:
        return SlamModel(
            navigation=None,
            state="none",
            message="SLAM does not run: record a navigation",
            landmarks=0,
            frames=0,
            t_robot_ns=None,
            T_world_body=None,
            T_world_cam=None,
            segment=0,
        )
    pose = live.pose
    hello = robot.state.hello
    camera = hello.calibration.camera if hello else None
    T_body_cam = camera.T_body_cam_matrix if camera else np.eye(4)
    running, left_to_do = robot.current_navigation.running, robot.current_navigation.left_to_do
    is_running = running is not None and running.id == live.navigation_id
    return SlamModel(
        navigation=live.navigation_id,
        state=(live.state or "initialising") if is_running else "finishing" if left_to_do else "finished",
        message=left_to_do or live.message,
        landmarks=live.num_landmarks,
        frames=live.frames,
        t_robot_ns=pose.t_robot_ns if pose else None,
        T_world_body=[float(x) for x in pose.T_world_body.ravel()] if pose else None,
        T_world_cam=[float(x) for x in (pose.T_world_body @ T_body_cam).ravel()] if pose else None,
        segment=pose.segment if pose else 0,
    )
