"""What a finished navigation says of the told camera: the map, unless it knows less than the drive's windows."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import pytest

from shared.calibration import REFERENCE_CAMERA, REFERENCE_ROBOT
from shared.geometry import FloatArray, se3
from station.model.calibration_fit import FITS, MISFITS, UNKNOWN, CalibrationFit, contradicted, judge
from station.model.frames import ImageFrame
from station.model.navigation import NavigationReport
from station.motion.head import NUM_ERRORS
from station.slam.mapping.camera_fit import CameraFit
from station.slam.ukf import finish
from station.slam.ukf.config import UkfConfig
from station.slam.ukf.map.keyframes import Keyframe
from station.slam.ukf.map.pose_log import PoseLog
from station.slam.ukf.map.view_map import ViewMap
from station.vision.camera_model import CameraModel
from station.vision.klt import TrackedFrame

REPORT = NavigationReport("ukf", 0, 0.0, 0.0, 0.0, 0.0, 0, 0.0, "metric", True, 0, {}, {})


def fit(scale: float, sigma: float) -> CalibrationFit:
    return judge((scale, sigma), np.zeros(3), np.full(3, 0.2), (0.0, 0.001))


NOTHING_SURE, RIGHT, WRONG = fit(1.0, 0.02), fit(1.0, 0.001), fit(0.95, 0.002)
AT_ODDS = contradicted(NOTHING_SURE, 20, 60.0)


@pytest.mark.parametrize(
    ("by_windows", "by_map", "expected"),
    [
        (WRONG, NOTHING_SURE, WRONG),  # places of such a map are not known
        (AT_ODDS, NOTHING_SURE, AT_ODDS),
        (WRONG, RIGHT, RIGHT),
        (RIGHT, WRONG, WRONG),
        (None, RIGHT, RIGHT),
        (WRONG, None, WRONG),
        (None, None, None),
    ],
)
def test_a_map_that_knows_nothing_of_its_camera_does_not_silence_the_windows(
    by_windows: CalibrationFit | None,
    by_map: CalibrationFit | None,
    expected: CalibrationFit | None,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert (NOTHING_SURE.verdict, RIGHT.verdict, WRONG.verdict) == (UNKNOWN, FITS, MISFITS) and AT_ODDS.is_contradicted
    made: Any = SimpleNamespace(
        calibration=REFERENCE_ROBOT, keyframes=(), landmarks=(), fit=by_map, facts={}, messages=[]
    )
    monkeypatch.setattr(finish, "_from_views", lambda *_: made)
    memory: Any = SimpleNamespace(calibration_check=SimpleNamespace(finish=lambda: by_windows), poses=PoseLog())
    camera = CameraModel.of(REFERENCE_CAMERA, 1.0)
    navigation = finish.make_navigation(
        "one", memory, camera, REFERENCE_ROBOT, np.zeros(NUM_ERRORS), UkfConfig(), REPORT, None
    )
    assert navigation.report.calibration_fit == expected


def test_tracks_are_triangulated_where_the_map_of_views_has_put_the_keyframes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Before plain walls views have few landmarks; tracks were taken with the filter's poses and the told camera."""
    built = CameraModel.of(REFERENCE_CAMERA, 1.0)
    told = msgspec.structs.replace(REFERENCE_CAMERA, fx=0.98 * REFERENCE_CAMERA.fx, fy=0.98 * REFERENCE_CAMERA.fy)
    robot = msgspec.structs.replace(REFERENCE_ROBOT, camera=told)
    rng = np.random.default_rng(1)
    points = np.column_stack([rng.uniform(1.5, 3.0, 40), rng.uniform(-0.5, 0.5, 40), rng.uniform(-0.3, 0.3, 40)])
    memory: Any = SimpleNamespace(
        views=(), poses=PoseLog(), calibration_check=SimpleNamespace(finish=lambda: None), keyframes=SimpleNamespace()
    )
    seen = [seen_from(np.array([0.0, 0.1 * k, 0.0]), k, points, built) for k in range(6)]
    memory.keyframes.items = [replace(keyframe, segment=k // 4) for k, keyframe in enumerate(seen)]
    for k in range(6):
        memory.poses.add(k, k, se3(np.eye(3), np.array([0.0, 0.13 * k, 0.0])), k // 4)  # the filter's scale is off

    def map_views(_views: Any, poses: PoseLog, camera: CameraFit, *_: Any) -> ViewMap:
        for k in range(6):
            poses.improve(k, se3(np.eye(3), np.array([0.0, 0.1 * k, 0.0])))
        nothing: Any = ()
        mapped = replace(camera, camera=REFERENCE_CAMERA)
        return ViewMap(nothing, nothing, mapped, 3, 0.4, shows_little=True, piece_of={0: 0, 1: 0})

    monkeypatch.setattr(finish, "map_views", map_views)
    nav = finish.make_navigation(
        "one", memory, CameraModel.of(told, 1.0), robot, np.zeros(NUM_ERRORS), UkfConfig(), REPORT, None
    )
    assert nav.report.config["mapped_from"] == "tracks" and nav.report.told_camera == told
    assert nav.calibration.camera == REFERENCE_CAMERA
    assert np.allclose(nav.keyframes.T_world_cam, nav.trajectory.T_world_body @ REFERENCE_CAMERA.T_body_cam_matrix)
    assert not nav.keyframes.segment.any()  # wheels carried it on, and views mapped both as one
    assert len(nav.landmarks) > 20
    nearest = np.linalg.norm(nav.landmarks.p_world[:, None] - points[None], axis=2).min(axis=1)
    assert nearest.max() < 1e-3


def seen_from(x_world: FloatArray, number: int, points: FloatArray, camera: CameraModel) -> Keyframe:
    """Points (N, 3) from a body that does not turn, where the filter thought it to be 1.3 times as far."""
    p_cam = camera.to_camera(points - x_world)
    xy = p_cam[:, :2] / p_cam[:, 2:]
    uv = camera.lens.project(xy)
    size = np.array([camera.lens.camera.width, camera.lens.camera.height])
    inside = ((uv > 0) & (uv < size)).all(axis=1) & (p_cam[:, 2] > 0)
    ids, none = np.flatnonzero(inside), np.zeros(3)
    tracked = TrackedFrame(ids, uv[inside], xy[inside], len(ids), 100.0)
    T = se3(np.eye(3), 1.3 * x_world)
    rgb = np.zeros((len(ids), 3), dtype=np.uint8)
    return Keyframe(ImageFrame(number, number, 0, b""), tracked, rgb, T, none, none, np.zeros(6), 0, None, None)
