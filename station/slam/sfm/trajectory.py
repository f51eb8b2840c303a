"""Poses for all frames, from those of the keyframes: turned by gyroscope, moved along a smooth curve."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import PchipInterpolator

from shared.geometry import FloatArray, IntArray, se3, so3_exp, so3_log
from station.model.navigation import Trajectory
from station.motion.inertial_track import InertialTrack

MAX_GAP_NS = 4_000_000_000  # keyframes further apart say little of the time between


def all_frames(
    t_keyframes_ns: IntArray,
    T_world_body: FloatArray,
    t_frames_ns: IntArray,
    track: InertialTrack | None,
) -> Trajectory:
    """Poses (N, 4, 4) at every frame between keyframes that are at most MAX_GAP_NS apart. All times are the IMU's.

    Positions follow a monotone cubic through the keyframes' (it does not overshoot where the robot stops). Rotations
    follow the gyroscope, its small error spread over the interval; without an IMU they turn evenly.
    """
    if len(t_keyframes_ns) < 2:
        return Trajectory(t_keyframes_ns, T_world_body)
    wanted = np.union1d(t_frames_ns, t_keyframes_ns)
    begin = np.clip(np.searchsorted(t_keyframes_ns, wanted, side="right") - 1, 0, len(t_keyframes_ns) - 2)
    t_a, t_b = t_keyframes_ns[begin], t_keyframes_ns[begin + 1]
    covered = (wanted >= t_a) & (wanted <= t_b) & (t_b - t_a <= MAX_GAP_NS)
    covered |= np.isin(wanted, t_keyframes_ns)
    wanted, begin = wanted[covered], begin[covered]
    seconds = (t_keyframes_ns - t_keyframes_ns[0]) * 1e-9
    positions = PchipInterpolator(seconds, T_world_body[:, :3, 3], axis=0)((wanted - t_keyframes_ns[0]) * 1e-9)
    turned = _relative_turns(t_keyframes_ns, wanted, begin, track)
    poses = []
    for i, k in enumerate(begin.tolist()):
        fraction = (wanted[i] - t_keyframes_ns[k]) / (t_keyframes_ns[k + 1] - t_keyframes_ns[k])
        R_a, R_b = T_world_body[k, :3, :3], T_world_body[k + 1, :3, :3]
        R_gyro, R_gyro_end = turned[0][i], turned[1][i]
        missing = so3_log(R_gyro_end.T @ R_a.T @ R_b)
        poses.append(se3(R_a @ R_gyro @ so3_exp(float(fraction) * missing), positions[i]))
    return Trajectory(wanted, np.stack(poses))


def _relative_turns(
    t_keyframes_ns: IntArray, wanted: IntArray, begin: IntArray, track: InertialTrack | None
) -> tuple[FloatArray, FloatArray]:
    """The gyroscope's turn from the keyframe before each wanted time, to that time and to the next keyframe."""
    still = np.broadcast_to(np.eye(3), (len(wanted), 3, 3))
    if track is None:
        return still, still
    at_keyframes = track.rotation_at(t_keyframes_ns)
    back = np.swapaxes(at_keyframes[begin], 1, 2)
    return back @ track.rotation_at(wanted), back @ at_keyframes[begin + 1]
