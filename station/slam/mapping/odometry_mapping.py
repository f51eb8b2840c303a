"""Structure from motion for a robot with IMU and drive commands: dead reckoning first, pictures then correct it.

A narrow camera that turns in rooms sees little parallax and, at times, a blank wall: images alone come apart there.
Gyroscope and wheels never do. So every keyframe starts at its dead-reckoned pose, tracks are triangulated from
there, and bundle adjustment (odometry_bundle.py) refines all, odometry included; then loops are closed and all is
refined again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from shared.calibration import CameraCalibration
from shared.geometry import FloatArray, IntArray, homogeneous
from station.model.frames import ImageFrame
from station.motion.inertial_track import InertialTrack
from station.slam.mapping.assemble import Reconstructed, good_landmarks, make_keyframes, make_landmarks
from station.slam.mapping.config import MappingConfig
from station.slam.mapping.loops import find_loops, landmarks_shown
from station.slam.mapping.odometry import MOTION_START, Odometry, RelativeMotions
from station.slam.mapping.odometry_bundle import (
    BundleState,
    MotionTerms,
    Observations,
    adjust,
    landmark_covariances,
    reprojection_errors,
)
from station.slam.mapping.rolling_shutter import RowMotion, moved_back, turned_back
from station.slam.mapping.tracks import Pairs, Tracks, build_tracks, longest
from station.vision.features import Features
from station.vision.lens import Lens
from station.vision.triangulation import intersect_rays
from station.vision.two_view import epipolar_inliers

LAST_SCALES = (1.5,)  # px, of robust losses: as sharp as the pictures
OBSERVATIONS_PER_KEYFRAME = 60  # in bundle adjustment; more do not move the poses
LEAST_ERROR_PX = 0.3  # a median below it is luck, or the points have followed their few observations
GATE = 4.0  # observations further off than this many scales wait for the next round


class Adjuster(Protocol):
    """Better poses of keyframes and points, by what is seen and what else is known of the motion."""

    def __call__(self, state: BundleState, seen: Observations, scale_px: float) -> BundleState:
        """Args: scale_px: of the robust loss."""
        ...


@dataclass(frozen=True, slots=True)
class Scales:
    """Of the robust losses, one round each (px): wide while poses are rough, or a loop has just been closed."""

    first: tuple[float, ...] = (12.0, 4.0)
    loop: tuple[float, ...] = (40.0, 10.0, 2.0)


DEAD_RECKONED_SCALES = Scales()


def by_motions(motion: MotionTerms, damping: float = 1e-4) -> Adjuster:
    """Our own bundle adjustment."""
    return lambda state, seen, scale_px: adjust(state, seen, motion, scale_px, damping)


@dataclass(frozen=True, slots=True, eq=False)
class OdometryMap:
    """Poses of all keyframes and their landmarks, metric as far as the drive commands are."""

    state: BundleState
    tracks: Tracks
    rays: Sequence[FloatArray]  # (n, 2) of each keyframe: normalised coordinates as if all rows were exposed at once
    num_loops: int
    num_matches: int
    median_error_px: float
    cov_world: FloatArray  # (M, 3, 3) m^2, given the poses


def map_with_odometry(
    features: Sequence[Features],
    matches: Sequence[Pairs],
    t_imu_ns: IntArray,
    odometry: Odometry,
    camera: CameraCalibration,
    config: MappingConfig,
) -> OdometryMap:
    """Reconstruct one navigation.

    Args:
        features, t_imu_ns: of the N keyframes; times on the IMU's clock.
        matches: unverified descriptor matches of keyframes near in time.
    """
    rays = [straight_rays(f, int(t), odometry.track, camera) for f, t in zip(features, t_imu_ns, strict=True)]
    return map_with_motions(features, rays, matches, odometry, camera, config, by_motions(odometry))


def map_with_motions(
    features: Sequence[Features],
    rays: Sequence[FloatArray],
    matches: Sequence[Pairs],
    odometry: RelativeMotions,
    camera: CameraCalibration,
    config: MappingConfig,
    adjuster: Adjuster,
    rows: Sequence[RowMotion] | None = None,
    scales: Scales = DEAD_RECKONED_SCALES,
) -> OdometryMap:
    """Map keyframes whose relative motions are given, whoever measured them.

    Args:
        adjuster: makes the poses better.
        rays: (n, 2) of each keyframe: its features' normalised coordinates as if the camera had not turned while it
            exposed its rows, at the time its pose is for.
        rows: how the camera of each keyframe moved meanwhile; None: it is not known, or all rows were exposed at once.
    """
    T_body_cam = camera.T_body_cam_matrix
    threshold = config.matching.max_error_px / camera.fx
    rng = np.random.default_rng(config.seed)
    verified = verify_by_gyro(matches, rays, odometry.T_world_body[:, :3, :3] @ T_body_cam[:3, :3], threshold, rng)
    verified = [pair for pair in verified if len(pair[2]) >= config.matching.min_gyro_inliers]

    state = BundleState(
        R_world_body=odometry.T_world_body[:, :3, :3].copy(),
        p_world_body=odometry.T_world_body[:, :3, 3].copy(),
        points=np.empty((0, 3)),
        motion=MOTION_START,
    )
    counts = [len(f) for f in features]
    tracks = build_tracks(counts, verified)
    state, kept = refine(state, tracks, rays, adjuster, camera, scales.first)
    turned = rays
    rays = stood_still(turned, rows, state, kept, camera)
    loops = find_loops(features, rays, state, kept, T_body_cam, camera.fx, odometry.drift, config.matching)
    if loops:
        # What did not fit its neighbours does not come back while residuals are wide.
        looped = build_tracks(counts, [*agreed(verified, kept, counts), *loops])
        state, kept = refine(state, looped, rays, adjuster, camera, scales.loop)
        tracks = build_tracks(counts, [*verified, *loops])
        rays = stood_still(turned, rows, state, kept, camera)
    state, kept = refine(state, tracks, rays, adjuster, camera, LAST_SCALES)
    return odometry_map(state, kept, rays, camera, len(loops), len(verified))


def odometry_map(
    state: BundleState,
    tracks: Tracks,
    rays: Sequence[FloatArray],
    camera: CameraCalibration,
    num_loops: int,
    num_matches: int,
) -> OdometryMap:
    """A state with how well it explains its tracks, and how well its landmarks are known."""
    seen = observations(tracks, rays, camera)
    median = median_error_px(state, seen)
    noise_px = max(median, LEAST_ERROR_PX)
    return OdometryMap(state, tracks, rays, num_loops, num_matches, median, landmark_covariances(state, seen, noise_px))


def median_error_px(state: BundleState, seen: Observations) -> float:
    """0 where nothing was seen."""
    errors = reprojection_errors(state, seen)
    return float(np.median(errors)) if len(errors) else 0.0


def straight_rays(features: Features, t_imu_ns: int, track: InertialTrack, camera: CameraCalibration) -> FloatArray:
    """Normalised image coordinates (N, 2) as if all rows had been exposed with the first one.

    The gyroscope knows how far the camera turned until row v was exposed; what it moved meanwhile (a few mm) is left.
    """
    xy = Lens(camera).unproject(features.uv_px)
    if camera.line_delay_s == 0.0 or not len(xy):
        return xy
    middle = np.array([t_imu_ns + round(0.5e9 * camera.line_delay_s * camera.height)])
    R_cam_body = camera.T_cam_body_matrix[:3, :3]
    omega_cam = R_cam_body @ track.rate_at(middle)[0]
    return turned_back(xy, features.uv_px[:, 1] * camera.line_delay_s, omega_cam)


def stood_still(
    rays: Sequence[FloatArray],
    rows: Sequence[RowMotion] | None,
    state: BundleState,
    tracks: Tracks,
    camera: CameraCalibration,
) -> Sequence[FloatArray]:
    """The rays of landmarks as if the camera had stood still while it exposed its rows.

    At 0.4 m/s it moves by 5 mm in half an image of 30 us a row: a pixel of what is 2 m away, and more than the inertial
    readings leave open between two keyframes. How much depends on the depth, so that only landmarks are moved.
    """
    if rows is None:
        return rays
    T_body_cam = camera.T_body_cam_matrix
    R_cam = (state.R_world_body @ T_body_cam[:3, :3])[tracks.keyframe]
    centre = state.p_world_body + state.R_world_body @ T_body_cam[:3, 3]
    depth = np.einsum("nj,nj->n", state.points[tracks.point] - centre[tracks.keyframe], R_cam[:, :, 2])
    first = np.concatenate([[0], np.cumsum([len(r) for r in rays])])
    at = first[tracks.keyframe] + tracks.feature
    out = np.vstack(rays)
    delay_s = np.concatenate([r.delay_s for r in rows])[at]
    v_cam = np.array([r.v_cam for r in rows])[tracks.keyframe]
    out[at] = moved_back(out[at], depth, delay_s, v_cam)
    return np.split(out, first[1:-1])


def agreed(matches: Sequence[Pairs], tracks: Tracks, counts: Sequence[int]) -> list[Pairs]:
    """The pairs of each match whose two features show one landmark of these tracks."""
    shown = landmarks_shown(tracks, counts)
    out: list[Pairs] = []
    for a, b, pairs in matches:
        of_a, of_b = shown[a][pairs[:, 0]], shown[b][pairs[:, 1]]
        out.append((a, b, pairs[(of_a >= 0) & (of_a == of_b)]))
    return out


def verify_by_gyro(
    matches: Sequence[Pairs],
    rays: Sequence[FloatArray],
    R_world_cam: FloatArray,
    threshold: float,
    rng: np.random.Generator,
) -> list[Pairs]:
    """The pairs of each match that agree with the gyroscope's rotation and one direction of motion."""
    out: list[Pairs] = []
    for a, b, pairs in matches:
        if len(pairs) < 3:
            continue
        R_a_b = R_world_cam[a].T @ R_world_cam[b]
        good = epipolar_inliers(rays[a][pairs[:, 0]], rays[b][pairs[:, 1]], R_a_b, threshold, rng)
        out.append((a, b, pairs[good]))
    return out


def refine(
    state: BundleState,
    tracks: Tracks,
    rays: Sequence[FloatArray],
    adjuster: Adjuster,
    camera: CameraCalibration,
    scales: Sequence[float],
) -> tuple[BundleState, Tracks]:
    """Triangulate all tracks and adjust, with ever stricter residuals; the observations that fit at the end."""
    kept = tracks
    for scale in scales:
        kept, points = triangulate_and_prune(state, tracks, rays, camera, GATE * scale)
        used = longest(kept, OBSERVATIONS_PER_KEYFRAME)
        few = kept.only(used[kept.point])
        state = adjuster(replace(state, points=points[used]), observations(few, rays, camera), scale)
    kept, points = triangulate_and_prune(state, tracks, rays, camera, GATE * [*LAST_SCALES, *scales][-1])
    return replace(state, points=points), kept


def triangulate_and_prune(
    state: BundleState, tracks: Tracks, rays: Sequence[FloatArray], camera: CameraCalibration, gate_px: float
) -> tuple[Tracks, FloatArray]:
    """Points of all tracks from the present poses; observations that do not fit are left out, then whole points."""
    T_body_cam = camera.T_body_cam_matrix
    R_cam = state.R_world_body @ T_body_cam[:3, :3]
    centre = state.p_world_body + state.R_world_body @ T_body_cam[:3, 3]
    current, seen = tracks, observations(tracks, rays, camera)
    points, defined = np.zeros((tracks.num_points, 3)), np.zeros(tracks.num_points, dtype=bool)
    error = np.zeros(len(seen.xy))
    changed = tracks.alive(np.ones(len(seen.xy), dtype=bool), 1)  # points that are to be found anew
    for _ in range(3):
        at = changed[current.point]
        part = current.only(at, 1)
        its = replace(seen, keyframe=part.keyframe, point=part.point, xy=seen.xy[at])
        directions = np.einsum("nij,nj->ni", R_cam[part.keyframe], homogeneous(its.xy))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        found = intersect_rays(part.point, part.num_points, centre[part.keyframe], directions)
        points[changed], defined[changed] = found
        error[at] = reprojection_errors(replace(state, points=found[0]), its)
        good = defined[current.point] & (error < gate_px)
        if good.all():
            break
        # Drop the worst first: one false match spoils the point for the others.
        worst = np.zeros(current.num_points)
        finite = np.where(np.isfinite(error), error, 1e9)
        np.maximum.at(worst, current.point, finite)
        is_worst = (finite >= worst[current.point]) & ~good
        drop = is_worst | ~defined[current.point]
        alive = current.alive(~drop)
        kept = ~drop & alive[current.point]
        changed = (np.bincount(current.point[drop], minlength=current.num_points) > 0)[alive]
        points, defined, error = points[alive], defined[alive], error[kept]
        current, seen = current.only(~drop), replace(seen, xy=seen.xy[kept])
    good = error < gate_px
    points = points[current.alive(good)]
    return current.only(good), points


def gather(tracks: Tracks, rays: Sequence[FloatArray]) -> FloatArray:
    """(K, 2) the normalised coordinates of all observations."""
    offset = np.concatenate([[0], np.cumsum([len(r) for r in rays])])
    return np.vstack(rays)[offset[tracks.keyframe] + tracks.feature]


def observations(tracks: Tracks, rays: Sequence[FloatArray], camera: CameraCalibration) -> Observations:
    """Tracks as the bundle adjustment wants them."""
    focal = 0.5 * (camera.fx + camera.fy)
    return Observations(tracks.keyframe, tracks.point, gather(tracks, rays), camera.T_cam_body_matrix, focal)


def read_odometry_map(
    made: OdometryMap,
    frames: Sequence[ImageFrame],
    features: Sequence[Features],
    camera: CameraCalibration,
    config: MappingConfig,
) -> Reconstructed:
    """The map as plain arrays; every keyframe has a pose there."""
    T_world_body = np.zeros((len(frames), 4, 4))
    T_world_body[:, :3, :3] = made.state.R_world_body
    T_world_body[:, :3, 3] = made.state.p_world_body
    T_world_body[:, 3, 3] = 1.0
    keyframes = make_keyframes(frames, T_world_body @ camera.T_body_cam_matrix)
    tracks = made.tracks
    uv = gather(tracks, [f.uv_px for f in features])
    centres = keyframes.T_world_cam[:, :3, 3]
    keep = good_landmarks(made.state.points, tracks.point, tracks.keyframe, centres, config)
    landmarks = make_landmarks(keyframes, keep, made.state.points, made.cov_world, tracks.point, tracks.keyframe, uv)
    return Reconstructed(keyframes, landmarks, camera, is_drive_metric=True)
