"""The metre and the vertical of a map: its shape laid on what the accelerometer felt along the whole navigation.

A filter learns its scale as it drives, and hands on what it believed at each moment; pictures have none. A map whose
loops are closed has one scale everywhere, so that every start, stop and turn of the drive tells of it together.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from shared.calibration import CameraCalibration
from shared.geometry import FloatArray, upright
from station.slam.mapping.inertial_terms import InertialTerms
from station.slam.mapping.odometry_bundle import BundleState
from station.slam.mapping.odometry_mapping import LAST_SCALES, OdometryMap, by_motions, odometry_map, refine

ROUNDS = 2  # observations that fitted only the old scale or tilt come back in the second


def lay_on_imu(
    made: OdometryMap,
    T_world_body: FloatArray,
    v_world: FloatArray,
    terms: InertialTerms,
    camera: CameraCalibration,
) -> OdometryMap:
    """The map adjusted again, with the inertial readings in place of relative motions; upright.

    Args:
        T_world_body, v_world: (N, 4, 4), (N, 3) poses and velocities as they were known before the map.
    """
    state = _upright(made.state, T_world_body[:, 2, :3])
    turned = state.R_world_body @ np.swapaxes(T_world_body[:, :3, :3], 1, 2)
    state = replace(state, motion=terms.start((turned @ v_world[:, :, None])[:, :, 0]))
    adjuster = by_motions(terms, damping=1e-8)
    state, kept = refine(state, made.tracks, made.rays, adjuster, camera, LAST_SCALES * ROUNDS)
    return odometry_map(state, kept, made.rays, camera, made.num_loops, made.num_matches)


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
