"""The metre and the vertical of a map: its shape laid on what the accelerometer felt along the whole navigation.

A filter learns its scale as it drives, and hands on what it believed at each moment; pictures have none. A map whose
loops are closed has one scale everywhere, so that every start, stop and turn of the drive tells of it together. So it
does of the camera (camera_fit.py): half a per cent of focal length makes a map 3 % too large.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from shared.calibration import CameraCalibration
from shared.geometry import FloatArray, upright
from station.slam.mapping.camera_fit import CameraFit
from station.slam.mapping.inertial_terms import InertialTerms
from station.slam.mapping.odometry_bundle import BundleState, Observations
from station.slam.mapping.odometry_mapping import (
    LAST_SCALES,
    LEAST_ERROR_PX,
    OBSERVATIONS_PER_KEYFRAME,
    OdometryMap,
    by_motions,
    median_error_px,
    observations,
    odometry_map,
    refine,
    stood_still,
)
from station.slam.mapping.rolling_shutter import RowMotion
from station.slam.mapping.tracks import longest

RAYLEIGH_MEDIAN = 1.177  # median length of a plane's vector whose two components are off by one sigma
CAUCHY_EFFICIENT = 2.385  # sigmas: what Cauchy's loss keeps 95 % of the information at where nothing is wrong
ROUNDS = 2  # observations that fitted only the old scale, tilt or camera come back in the second

# The rays of all features and how the camera moved meanwhile, by a camera and how much later than told it took them.
SeenBy = Callable[[CameraCalibration, float], tuple[Sequence[FloatArray], Sequence[RowMotion]]]


def lay_on_imu(
    made: OdometryMap,
    T_world_body: FloatArray,
    v_world: FloatArray,
    terms: InertialTerms,
    camera: CameraFit,
    seen_by: SeenBy | None,
) -> tuple[OdometryMap, CameraFit]:
    """The map adjusted again, with the inertial readings in place of relative motions; upright.

    Args:
        T_world_body, v_world: (N, 4, 4), (N, 3) poses and velocities as they were known before the map.
        camera: that it was made with.
        seen_by: None where the camera stays as it is.
    Returns:
        Also the camera as the map has it then.
    """
    state = _upright(made.state, T_world_body[:, 2, :3])
    turned = state.R_world_body @ np.swapaxes(T_world_body[:, :3, :3], 1, 2)
    state = replace(state, motion=terms.start((turned @ v_world[:, :, None])[:, :, 0]))
    adjuster = by_motions(terms, damping=1e-8)
    rays, kept = made.rays, made.tracks
    scales: tuple[float, ...] = LAST_SCALES
    for left in reversed(range(ROUNDS)):
        state, kept = refine(state, made.tracks, rays, adjuster, camera.camera, scales)
        if left:
            scales = (*LAST_SCALES, _scale_px(state, observations(kept, rays, camera.camera)))
        if seen_by is not None and left:
            used = longest(kept, OBSERVATIONS_PER_KEYFRAME)
            few = observations(kept.only(used[kept.point]), rays, camera.camera)
            _, rows = seen_by(camera.camera, camera.late_s)
            camera = camera.improved(replace(state, points=state.points[used]), few, terms, rows, scales[-1])
            turned_back, rows = seen_by(camera.camera, camera.late_s)
            rays = stood_still(turned_back, rows, state, kept, camera.camera)
    made = odometry_map(state, kept, rays, camera.camera, made.num_loops, made.num_matches)
    return made, camera


def among(made: OdometryMap, at: Sequence[int]) -> OdometryMap:
    """The map of some of its keyframes."""
    number = np.full(len(made.rays), -1, dtype=np.int64)
    number[at] = np.arange(len(at))
    keep = np.asarray(number[made.tracks.keyframe] >= 0, dtype=np.bool_)
    tracks = made.tracks.only(keep)
    state = replace(
        made.state,
        R_world_body=made.state.R_world_body[at],
        p_world_body=made.state.p_world_body[at],
        points=made.state.points[made.tracks.alive(keep)],
    )
    rays = [made.rays[k] for k in at]
    return replace(made, state=state, tracks=replace(tracks, keyframe=number[tracks.keyframe]), rays=rays)


def moved_to(made: OdometryMap, T_world_body: FloatArray, camera: CameraCalibration) -> OdometryMap:
    """The map with its keyframes at other poses (N, 4, 4): what they show is triangulated anew, nothing adjusted."""
    state = replace(made.state, R_world_body=T_world_body[:, :3, :3], p_world_body=T_world_body[:, :3, 3])
    state, kept = refine(state, made.tracks, made.rays, lambda state, *_: state, camera, ())
    return odometry_map(state, kept, made.rays, camera, made.num_loops, made.num_matches)


def _scale_px(state: BundleState, seen: Observations) -> float:
    """Of the robust loss, by what the map's own features are off by.

    Where views show little, somebody's legs and look-alikes are a tenth of what they share. By a pixel and a half,
    several times what true features are off by, they count nearly as those do: they bend the map and its metre.
    """
    sigma_px = max(median_error_px(state, seen), LEAST_ERROR_PX) / RAYLEIGH_MEDIAN
    return CAUCHY_EFFICIENT * sigma_px


def _upright(state: BundleState, up_body: FloatArray) -> BundleState:
    """Turned about the first pose, so that on the whole "up" (N, 3) of each body is up."""
    up = np.median(np.einsum("nij,nj->ni", state.R_world_body, up_body), axis=0)
    R, p = upright(up), state.p_world_body[0]
    return replace(
        state,
        R_world_body=R @ state.R_world_body,
        p_world_body=(state.p_world_body - p) @ R.T + p,
        points=(state.points - p) @ R.T + p,
    )
