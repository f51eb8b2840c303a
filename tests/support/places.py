"""A small map and images recognised in it, for tests of the current place."""

from __future__ import annotations

import numpy as np

from shared.calibration import Calibration, CameraCalibration
from shared.geometry import FloatArray, se3, yaw_rotation
from station.model.navigation import Keyframes, Landmarks, Navigation, NavigationReport, Trajectory
from station.model.place_answer import Localization
from station.model.place_map import Place, PlaceMap
from station.places.tracking.config import BeliefConfig
from station.places.tracking.current import CurrentPlaceEstimator
from station.places.tracking.fitted import FailureOdds, FittedOdds, RecognisedOdds, Usual

R_BODY_CAM = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])  # looks along body x
SECOND = 1_000_000_000
# Plausible odds that stay as they are: what is tested is what the estimator makes of them, not what was fitted last.
ODDS = FittedOdds(
    made_by="",
    worlds=(),
    log_loss={},
    usual=Usual(support=0.2, off_floor=1.0),
    right=RecognisedOdds(16.254, extent=2.86, inliers=0.49, support=1.78, features=-1.54, off_floor=-0.5, free=0.0),
    tried=0.0,
    unmapped=RecognisedOdds(-6.834, extent=0.51, inliers=-1.43, support=0.17, features=2.03, off_floor=0.0, free=0.0),
    fails_at_pose=FailureOdds(2.203, features=-0.84, again=1.68, in_view=-0.81),
    fails_in_map=FailureOdds(5.22, features=-1.15, again=2.17),
    fails_unmapped=FailureOdds(9.696, features=-1.62, again=2.48),
)
CONFIG = BeliefConfig(fitted=ODDS)


def estimator_of(*maps: PlaceMap) -> CurrentPlaceEstimator:
    """Of a robot on wheels in these maps."""
    return CurrentPlaceEstimator(maps, config=CONFIG)


def pose(x: float, y: float, yaw: float = 0.0) -> FloatArray:
    return se3(yaw_rotation(yaw), np.array([x, y, 0.0]))


def make_map(
    map_id: str = "map", places: int = 3, more: FloatArray | None = None, scale: float | None = None
) -> PlaceMap:
    """A drive along x from 0 to 6 m; places at x = 0, 3, 6, a landmark each; then `more` (n, 3) landmarks.

    `scale`: all this many times as large, in a map whose scale nobody knows.
    """
    unit = 1.0 if scale is None else scale
    camera = CameraCalibration(
        width=640,
        height=480,
        fx=500,
        fy=500,
        cx=320,
        cy=240,
        T_body_cam=tuple(se3(R_BODY_CAM, np.zeros(3)).ravel().tolist()),
    )
    xs = np.linspace(0, 6, 25) * unit
    T = np.stack([pose(x, 0.0) @ se3(R_BODY_CAM, np.zeros(3)) for x in xs])
    t = np.arange(25) * SECOND
    centroids = np.array([[3.0 * i, 0.0, 0.3] for i in range(places)]).reshape(-1, 3) * unit
    p_world = np.concatenate([centroids, np.zeros((0, 3)) if more is None else more * unit])
    landmarks = Landmarks(
        p_world=p_world,
        rgb=np.zeros((len(p_world), 3), dtype=np.uint8),
        cov_world=np.zeros((len(p_world), 3, 3)),
        observed_landmark=np.arange(places),
        observed_keyframe=np.zeros(places, dtype=np.int64),
        observed_uv_px=np.zeros((places, 2)),
    )
    report = NavigationReport(
        "test", 25, 25, 1, 1, 1, places, 0, "metric" if scale is None else "arbitrary", True, 0, {}, {}
    )
    navigation = Navigation(
        id="nav",
        calibration=Calibration(camera=camera, imu=None, rig="wheels"),
        trajectory=Trajectory(t, T),
        keyframes=Keyframes(np.arange(25), t, T, (b"",) * 25, np.zeros(25, dtype=np.int64)),
        landmarks=landmarks,
        report=report,
    )
    made = tuple(
        Place(f"{map_id}-{i}", f"Place {i}", centroids[i], 0.3 * unit, np.array([i]), np.array([0]), 0, 1.0)
        for i in range(places)
    )
    return PlaceMap(map_id, map_id, navigation, made, (), {})


def seen(
    t_s: float,
    T_map_body: FloatArray,
    inliers: int = 200,
    map_id: str = "map",
    landmarks: tuple[int, ...] = (),
    extent: float = 0.4,
    num_features: int = 500,
) -> Localization:
    return Localization(
        t_robot_ns=int(t_s * SECOND),
        T_map_cam=T_map_body @ se3(R_BODY_CAM, np.zeros(3)),
        num_inliers=inliers,
        inlier_ratio=0.6,
        sigma_position=0.03,
        keyframe_index=4,
        map_id=map_id,
        extent=extent,
        num_features=num_features,
        landmarks=np.array(landmarks, dtype=np.int64),
    )
