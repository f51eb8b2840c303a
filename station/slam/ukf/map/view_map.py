"""The map from views: loops closed, all views and landmarks refined together (docs/slam.md, sec. 10).

Between views the filter's own relative motions hold what pictures cannot, as dead reckoning does in structure from
motion; the machinery is the same (station/slam/mapping/odometry_mapping.py).
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from shared.calibration import CameraCalibration, ImuNoise
from shared.geometry import FloatArray, inverse, se3, skew, so3_log, upright
from station.model.navigation import Keyframes, Landmarks, join_maps
from station.motion.head import SIGMA_PLAY_RAD
from station.slam.mapping.assemble import Reconstructed
from station.slam.mapping.camera_fit import CameraFit
from station.slam.mapping.inertial_mapping import SeenBy, among, lay_on_imu, moved_to
from station.slam.mapping.inertial_terms import HeadTerms, InertialTerms, WheelTerms
from station.slam.mapping.odometry import SLIP, SLIP_PER_RADIAN_M, Drift, RelativeMotions
from station.slam.mapping.odometry_mapping import (
    DEAD_RECKONED_SCALES,
    Adjuster,
    OdometryMap,
    Scales,
    by_motions,
    map_with_motions,
    read_odometry_map,
)
from station.slam.mapping.rolling_shutter import RowMotion, turned_back
from station.slam.ukf.filter.constraints import WheelsKnown
from station.slam.ukf.map.keyframes import Keyframe
from station.slam.ukf.map.pose_log import PoseLog, follow_poses
from station.slam.ukf.map.views import MapViews, View, joined
from station.vision.camera_model import CameraModel
from station.vision.klt import MIN_FOLLOWED

MIN_VIEWS = 3
LEAST_SPACING_NS = 190_000_000  # of views between which a turned head's map is laid on the IMU: ViewConfig's, nearly
SMOOTHED_SCALES = Scales(first=(), loop=(10.0,))  # poses that least squares has made need no way in
# SIFT cannot tell the fields of a chessboard apart: tracks give 4 to 6 times as many landmarks there. Before plain
# walls they give up to twice as many, and those of views are recognised again (docs/studies/ukf-map.md).
MAX_TRACKS_PER_LANDMARK = 3
MIN_SHOWN = 3  # landmarks of a view: as many as say where it is; by fewer IMU and wheels alone would
# How wrong the filter's motion between neighbouring views may be beside its scale; one sigma. Twice its scatter, since
# errors of ten neighbours add up to 1.7 times what independent ones would (docs/decisions/0023-metre-of-a-map.md).
SIGMA_SHARE = 0.02  # of the way
SIGMA_PER_RADIAN_M = 0.004
SIGMA_FLOOR_M = 0.001
SIGMA_BIAS_RAD_S = 5e-4
SIGMA_TURN_SHARE = 0.001
SIGMA_HEAD_SHARE = 0.01  # of a turn of the head, which images alone measure
SIGMA_FLOOR_RAD = 2e-4
# Drives of 20 m are followed within some 0.05 m; with what dead reckoning may be off by, chairs that look alike closed
# loops (docs/studies/ukf-map.md).
DRIFT = Drift(position_m=0.15, position_per_way=0.02, rotation_rad=0.09)
# Where tracking was lost in between: a new start knows up from half a second of the accelerometer, and what the filter
# said just before it was lost may be wrong. A third of what a loop may correct.
BRIDGE_FLOOR_M, BRIDGE_FLOOR_RAD = DRIFT.position_m / 3, DRIFT.rotation_rad / 3


@dataclass(frozen=True, slots=True, eq=False)
class BetterKnown:
    """What a backend that builds on the filter knows at the end: its poses are in the pose log already."""

    camera: CameraCalibration
    adjuster_of: dict[int, Callable[[list[int], FloatArray], Adjuster]]  # by segment: of views by frame index and pose


@dataclass(frozen=True, slots=True, eq=False)
class ViewMap:
    """Keyframes and landmarks of all segments."""

    keyframes: Keyframes
    landmarks: Landmarks
    camera: CameraFit  # that they were made with
    num_loops: int
    median_error_px: float
    shows_little: bool  # tracks give many times more landmarks
    piece_of: dict[int, int]  # by segment with views: the number that its keyframes have


def map_views(
    views: MapViews,
    poses: PoseLog,
    camera: CameraFit,
    sigma_px: float,
    noise: ImuNoise,
    gravity: float,
    wheels: WheelsKnown | None,
    count_tracks: Callable[[], int],
    servo_errors: FloatArray,
    better: BetterKnown | None = None,
) -> ViewMap | None:
    """Map every piece of the drive and move its poses along. `wheels`: what is known of them before the drive.

    A piece is a segment and those that wheels and IMU have carried on from it.

    Args:
        camera: as it is known before; the longest piece says what it is, and the others are mapped with that.
        servo_errors: (NUM_ERRORS,) of the head that carries the camera, as the drive's end knows them.
        better: whose equations hold the IMU, so that they are asked in place of the filter's motions.
        count_tracks: how many landmarks tracks give.

    None where views have no landmarks, or tracks give many times more and most views show too few to be placed by them.
    """
    parts: dict[int, tuple[Reconstructed, list[View]]] = {}
    loops, errors = 0, []
    described, matches = views.describe_all()
    # Smoothing solves each segment by itself.
    pieces = [v.segment if better is not None else views.piece(v.segment) for v in described]
    for number in sorted(set(pieces), key=lambda number: (-pieces.count(number), number)):
        at = [i for i, other in enumerate(pieces) if other == number]
        if len(at) < MIN_VIEWS:
            continue
        items = [described[i] for i in at]
        pairs = [(a - at[0], b - at[0], p) for a, b, p in matches if a >= at[0] and b <= at[-1]]
        motions = relative_motions(items, noise)
        features = [v.features for v in items]
        seen_by = _seen_by(items, sigma_px)
        rays, rows = seen_by(camera.camera, camera.late_s)
        adjuster, scales = by_motions(motions), DEAD_RECKONED_SCALES
        is_smoothed = better is not None and number in better.adjuster_of
        if better is not None and is_smoothed:
            adjuster, scales = (
                better.adjuster_of[number]([v.frame_index for v in items], motions.T_world_body),
                SMOOTHED_SCALES,
            )
        made = map_with_motions(features, rays, pairs, motions, camera.camera, views.mapping, adjuster, rows, scales)
        if made.tracks.num_points == 0:
            continue
        terms = None if is_smoothed else inertial_terms(items, noise, gravity, wheels, servo_errors)
        if terms is not None:
            v_world = np.array([v.keyframe.v_world for v in items])
            # One camera has made all pieces; and a head's angles would take the mounting's place.
            is_fixed = bool(parts) or terms.has_head
            at = spaced(items)
            if len(at) == len(items):
                made, camera = lay_on_imu(
                    made, motions.T_world_body, v_world, terms, camera, None if is_fixed else seen_by
                )
            elif (few := inertial_terms(_only(items, at), noise, gravity, wheels, servo_errors)) is not None:
                laid, camera = lay_on_imu(among(made, at), motions.T_world_body[at], v_world[at], few, camera, None)
                t_ns = np.array([v.keyframe.image.t_robot_ns for v in items])
                T_made = _poses(made)
                T_laid = follow_poses(T_made, t_ns, T_made[at], _poses(laid), t_ns[at])
                made = moved_to(made, T_laid, camera.camera)
        part = read_odometry_map(made, [v.keyframe.image for v in items], features, camera.camera, views.mapping)
        if terms is None and not is_smoothed:
            part = level(part, motions.T_world_body, camera.camera)
        parts[number] = (part, items)
        loops += made.num_loops
        errors.append(made.median_error_px)
    in_order = [parts[number] for number in sorted(parts)]
    if not any(len(part.landmarks) for part, _ in in_order):
        return None
    keyframes, landmarks = _join(in_order)
    shows_little = MAX_TRACKS_PER_LANDMARK * len(landmarks) < count_tracks()
    if shows_little and not _are_placed(keyframes, landmarks):
        return None
    for part, items in in_order:
        T_filter = np.array([_T_world_body(v.keyframe) for v in items])
        T_new = (
            part.keyframes.T_world_cam @ camera.camera.T_cam_body_matrix @ inverse(_T_body_head(items, servo_errors))
        )
        for segment in sorted({v.segment for v in items}):
            at = [k for k, v in enumerate(items) if v.segment == segment]
            poses.follow([items[k].frame_index for k in at], T_filter[at], T_new[at], segment)
    piece_of = {v.segment: items[0].segment for _, items in in_order for v in items}
    return ViewMap(keyframes, landmarks, camera, loops, float(np.mean(errors)), shows_little, piece_of)


def spaced(items: list[View]) -> list[int]:
    """The views that the inertial readings are asked between: all, but of a head that turned none too near in time.

    Where it turns with its body views are a tenth of a second apart. By how pictures err in that time a map is
    accelerated more than the IMU felt, and grows too small (docs/studies/current-place.md, "A head that turns").
    """
    if all(v.keyframe.head is None for v in items):
        return list(range(len(items)))
    at = [0]
    for k, view in enumerate(items):
        if view.keyframe.image.t_robot_ns - items[at[-1]].keyframe.image.t_robot_ns >= LEAST_SPACING_NS:
            at.append(k)
    return at


def _only(items: list[View], at: list[int]) -> list[View]:
    """Some of the views, linked over those between them."""
    out = [items[at[0]]]
    for before, k in itertools.pairwise(at):
        link = items[before + 1].keyframe.link
        for between in items[before + 2 : k + 1]:
            link = joined(link, between.keyframe.link)
        out.append(replace(items[k], keyframe=replace(items[k].keyframe, link=link)))
    return out


def _poses(made: OdometryMap) -> FloatArray:
    """(N, 4, 4)"""
    return np.array([se3(R, p) for R, p in zip(made.state.R_world_body, made.state.p_world_body, strict=True)])


def _are_placed(keyframes: Keyframes, landmarks: Landmarks) -> bool:
    """Whether most views show landmarks enough: the filter's poses know of all tracks, which IMU and wheels do not."""
    shown = np.bincount(landmarks.observed_keyframe, minlength=len(keyframes))
    return bool(np.median(shown) >= MIN_SHOWN)


def _T_world_body(keyframe: Keyframe) -> FloatArray:
    """(4, 4) as the filter had it."""
    T, T_body_head = keyframe.T_world_head, keyframe.T_body_head
    return T if T_body_head is None else T @ inverse(T_body_head)


def _seen_by(items: list[View], sigma_px: float) -> SeenBy:
    def seen_by(camera: CameraCalibration, late_s: float) -> tuple[list[FloatArray], list[RowMotion]]:
        model = CameraModel.of(camera, sigma_px)
        return [straight_rays(v, model, late_s) for v in items], [row_motion(v, model, late_s) for v in items]

    return seen_by


def relative_motions(items: list[View], noise: ImuNoise) -> RelativeMotions:
    """The filter's motion of the head from each view to the next, and how far to trust it."""
    T = np.array([v.keyframe.T_world_head for v in items])
    step = np.array([inverse(a) @ b for a, b in itertools.pairwise(T)])
    dt = np.diff([v.keyframe.image.t_robot_ns for v in items]) * 1e-9
    length = np.linalg.norm(step[:, :3, 3], axis=1)
    turn = np.linalg.norm(so3_log(step[:, :3, :3]), axis=1)
    sigma_position = np.sqrt(SIGMA_FLOOR_M**2 + (SIGMA_SHARE * length) ** 2 + (SIGMA_PER_RADIAN_M * turn) ** 2)
    sigma_rotation = np.sqrt(
        noise.gyro_density**2 * dt + (SIGMA_BIAS_RAD_S * dt) ** 2 + (SIGMA_TURN_SHARE * turn) ** 2 + SIGMA_FLOOR_RAD**2
    )
    sigma_rotation = np.hypot(sigma_rotation, SIGMA_HEAD_SHARE * _head_turns(items))
    is_bridge = (
        np.diff([v.segment for v in items]) != 0
    )  # led over by the IMU and wheels that slip, while images were lost
    sigma_position[is_bridge] = np.sqrt(
        BRIDGE_FLOOR_M**2 + (SLIP * length[is_bridge]) ** 2 + (SLIP_PER_RADIAN_M * turn[is_bridge]) ** 2
    )
    sigma_rotation[is_bridge] = np.hypot(sigma_rotation[is_bridge], BRIDGE_FLOOR_RAD)
    return RelativeMotions(
        T_world_body=T,
        R=step[:, :3, :3],
        R_sum=np.zeros((len(step), 3, 3)),  # the filter has estimated the gyroscope's bias
        p=step[:, :3, 3],
        sigma_rotation=sigma_rotation,
        sigma_position=np.repeat(sigma_position[:, None], 3, axis=1),
        drift=DRIFT,
        # Where images were followed the filter has left out wheels that contradict them.
        slips=is_bridge | np.array([v.keyframe.tracked.num_tracked < MIN_FOLLOWED for v in items[1:]], dtype=bool),
    )


def inertial_terms(
    items: list[View], noise: ImuNoise, gravity: float, wheels: WheelsKnown | None, servo_errors: FloatArray
) -> InertialTerms | None:
    """The IMU and the wheels along the views; None where readings are missing."""
    links = [v.keyframe.link for v in items[1:]]
    known = [link for link in links if link is not None]
    if len(known) < len(links):
        return None
    rolling = None if wheels is None else WheelTerms(wheels.mean, wheels.sigma)
    return InertialTerms(known, noise, gravity, items[-1].keyframe.bias, rolling, head_terms(items, servo_errors))


def head_terms(items: list[View], servo_errors: FloatArray) -> HeadTerms | None:
    """None while the head was never turned.

    What its servos are off by at each angle the filter has learned by the drive's end. Play is left, and is each view's
    own.
    """
    heads = [v.keyframe.head for v in items]
    turned = next((head for head in heads if head is not None), None)
    if turned is None:
        return None
    T = _T_body_head(items, servo_errors)
    axes = np.zeros((len(T), 3, 2))
    axes[:, 2, 0], axes[:, :, 1] = 1.0, -T[:, :3, 1]  # as HeadPose.by_angles
    axes[[head is None for head in heads]] = 0.0
    shifts = -skew(T[:, :3, 3] - np.array(turned.told.calibration.pivot_body)) @ axes
    return HeadTerms(T[:, :3, :3], T[:, :3, 3], axes, shifts, SIGMA_PLAY_RAD)


def _T_body_head(items: list[View], servo_errors: FloatArray) -> FloatArray:
    """(N, 4, 4) where the head was on the body, as the drive's end knows it."""
    heads = [v.keyframe.head for v in items]
    return np.array([np.eye(4) if head is None else head.T_body_head(servo_errors) for head in heads])


def _head_turns(items: list[View]) -> FloatArray:
    """(N-1,) rad, by how much the head turned on the body from each view to the next."""
    R = np.array([np.eye(3) if (T := v.keyframe.T_body_head) is None else T[:3, :3] for v in items])
    return np.linalg.norm(so3_log(np.swapaxes(R[:-1], 1, 2) @ R[1:]), axis=1)


def straight_rays(view: View, camera: CameraModel, late_s: float = 0.0) -> FloatArray:
    """Normalised image coordinates (N, 2) as if the camera had not turned since the pose's time.

    That is the middle row's, where the image was not taken `late_s` later than told.
    """
    xy = camera.lens.unproject(view.features.uv_px)
    if (camera.line_delay_s == 0.0 and late_s == 0.0) or not len(xy):
        return xy
    row = row_motion(view, camera, late_s)
    return turned_back(xy, row.delay_s, row.omega_cam)


def row_motion(view: View, camera: CameraModel, late_s: float = 0.0) -> RowMotion:
    """How the camera moved while it exposed this view, as the filter knew it then."""
    keyframe, R_cam_body = view.keyframe, camera.R_body_cam.T
    v_head = keyframe.T_world_head[:3, :3].T @ keyframe.v_world + np.cross(keyframe.omega_head, camera.t_body_cam)
    delay_s = camera.row_delay_s(view.features.uv_px[:, 1]) + late_s
    return RowMotion(delay_s, R_cam_body @ v_head, R_cam_body @ keyframe.omega_head)


def level(part: Reconstructed, T_filter: FloatArray, calibration: CameraCalibration) -> Reconstructed:
    """Turned so that, on the whole, "up" is where the filter had it: it feels gravity, the adjustment does not.

    The first view's position and yaw stay.
    """
    T = part.keyframes.T_world_cam @ calibration.T_cam_body_matrix
    up_body = T_filter[:, 2, :3]  # the world's z axis in each body frame, by the filter
    up = np.median(np.einsum("nij,nj->ni", T[:, :3, :3], up_body), axis=0)
    R = upright(up)
    turn = se3(R, T[0, :3, 3] - R @ T[0, :3, 3])
    keyframes = replace(part.keyframes, T_world_cam=turn @ part.keyframes.T_world_cam)
    return replace(part, keyframes=keyframes, landmarks=part.landmarks.moved(turn))


def _join(parts: list[tuple[Reconstructed, list[View]]]) -> tuple[Keyframes, Landmarks]:
    """Pieces one after the other, each with the number of its first segment."""
    keyframes, landmarks = join_maps([(part.keyframes, part.landmarks) for part, _ in parts])
    segment = np.array([items[0].segment for _, items in parts for _ in items], dtype=np.int64)
    return replace(keyframes, segment=segment), landmarks
