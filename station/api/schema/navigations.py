"""Recorded navigations, and what was deleted."""

from __future__ import annotations

from typing import Literal

import numpy as np
from pydantic import Field

from station.api.schema.base import Model, OptionalName, Question
from station.library.bin import BinEntry
from station.library.navigation_records import NavigationRecord
from station.model.navigation import Navigation


class NavigationModel(Model):
    """One recorded navigation and what SLAM made of it."""

    id: str = Field(examples=["nav-20260105-101500"])
    name: str
    state: Literal["recording", "finishing", "ready", "failed"]
    message: str
    robot: str = Field(description="its name in GET /robots when it drove; empty: an old navigation")
    started_unix_s: float
    duration_s: float
    backend: str
    frames: int
    frames_skipped: int = Field(description="by live SLAM; the recording has them")
    imu_samples: int
    imu_lost: int
    slam_failures: int = Field(description="pictures or samples that SLAM refused; the message quotes it")
    landmarks: int
    scale: Literal["metric", "arbitrary", ""]
    recording: str | None = Field(description="where to download the MCAP file")


class ReprocessOrder(Question):
    """How to run SLAM over a recording again."""

    backend: Literal["sfm", "ukf", "mono", "smoothing"] | None = Field(
        default=None, description="null: the station's own"
    )


class ReplayModel(Model):
    """Where the camera was during a recorded navigation; the pictures come by /ws/replay."""

    navigation: str
    start_ns: int = Field(description="robot clock, of the first pose")
    t_s: list[float] = Field(description="since start_ns, increasing; at most `limit` poses")
    T_world_cam: list[list[float]] = Field(description="row-major 4x4 each")


class NavigationStart(Question):
    name: OptionalName = Field(default="", examples=["Tuesday, all rooms"])


class BinModel(Model):
    """Something deleted that can still be restored."""

    kind: Literal["navigation", "map"]
    id: str = Field(examples=["nav-20260105-101500"])
    name: str
    deleted_unix_s: float
    gone_unix_s: float = Field(description="when it is deleted for good, where the station runs until then")


def replay_model(navigation_id: str, navigation: Navigation, limit: int) -> ReplayModel:
    times = navigation.trajectory.t_robot_ns
    chosen = np.unique(np.linspace(0, max(len(times) - 1, 0), min(limit, len(times))).round().astype(int))
    camera = navigation.calibration.camera
    T_body_cam = camera.T_body_cam_matrix if camera else np.eye(4)
    start_ns = int(times[0]) if len(times) else 0
    poses = navigation.trajectory.T_world_body[chosen] @ T_body_cam
    return ReplayModel(
        navigation=navigation_id,
        start_ns=start_ns,
        t_s=[(int(t) - start_ns) * 1e-9 for t in times[chosen]],
        T_world_cam=[[round(float(x), 5) for x in T.ravel()] for T in poses],
    )


def bin_model(entry: BinEntry) -> BinModel:
    return BinModel.of(entry, deleted_unix_s=entry.deleted_wall_s, gone_unix_s=entry.gone_wall_s)


def navigation_model(navigation: NavigationRecord) -> NavigationModel:
    recording = None if navigation.state == "recording" else f"/navigations/{navigation.id}/recording.mcap"
    return NavigationModel.of(navigation, started_unix_s=navigation.started_wall_s, recording=recording)
