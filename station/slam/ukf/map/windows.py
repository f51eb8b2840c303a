"""Windows of keyframes for visual-inertial least squares: which keyframes, and what is known of them beforehand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from shared.errors import DegenerateGeometry
from shared.geometry import FloatArray
from station.motion.preintegration import Preintegration, chain
from station.slam.mapping.inertial_bundle import Prior, WindowStates, WindowTracks, collect_tracks
from station.slam.ukf.filter.constraints import BodyVelocity
from station.slam.ukf.map.keyframes import Keyframe

# Keyframes nearer to each other move along with their neighbours. In fast turns they come 0.05 s apart, and windows of
# a second know little of tilt and scale (docs/studies/ukf.md).
SPACING_S = 0.149
MAX_TRACKS = 150
MIN_TRACKS = 20


class Spacer:
    """Chooses keyframes at least SPACING_S apart, with the IMU links of the others joined to theirs."""

    def __init__(self) -> None:
        self._last_ns: int | None = None  # of the last one that was chosen
        self._link: Preintegration | None = None  # since then

    def add(self, keyframe: Keyframe) -> Keyframe | None:
        """The keyframe as it is used; None: it is left out. One that nothing links to those before begins anew."""
        t_ns = keyframe.image.t_robot_ns
        if keyframe.link is None or self._last_ns is None:
            self._last_ns, self._link = t_ns, None
            return keyframe
        self._link = keyframe.link if self._link is None else chain(self._link, keyframe.link)
        if (t_ns - self._last_ns) * 1e-9 < SPACING_S:
            return None
        chosen = replace(keyframe, link=self._link)
        self._last_ns, self._link = t_ns, None
        return chosen


@dataclass(frozen=True, slots=True, eq=False)
class Window:
    """What `solve_window` is given."""

    states: WindowStates
    links: list[Preintegration]
    tracks: WindowTracks
    prior: Prior


def window_of(keyframes: Sequence[Keyframe], sigma_first: FloatArray) -> Window:
    """A window of linked keyframes.

    Args:
        sigma_first: (15,) of the first keyframe's state: rotation, velocity, position, biases of gyroscope and
            accelerometer.
    Raises:
        DegenerateGeometry: too few features were followed.
    """
    tracks = _longest(collect_tracks([k.tracked for k in keyframes], 3))
    if len(tracks.ids) < MIN_TRACKS:
        raise DegenerateGeometry("too few features were followed")
    states = WindowStates(
        R=np.array([k.T_world_head[:3, :3] for k in keyframes]),
        v=np.array([k.v_world for k in keyframes]),
        x=np.array([k.T_world_head[:3, 3] for k in keyframes]),
        bias=np.array([k.bias for k in keyframes]),
        omega=np.array([k.omega_head for k in keyframes]),
    )
    wheels = [k.wheels for k in keyframes]
    has_wheels = any(w is not None for w in wheels)
    nothing = BodyVelocity(np.zeros(3), np.full(3, np.inf))
    prior = Prior(
        bias_gyro=states.bias[0, :3],
        bias_accel=states.bias[0, 3:],
        sigma_bias_gyro=float(sigma_first[9:12].mean()),
        sigma_bias_accel=float(sigma_first[12:].mean()),
        v_first=states.v[0],
        sigma_v=max(float(sigma_first[3:6].mean()), 1e-3),
        R_first=states.R[0],
        sigma_phi=max(float(sigma_first[:3].mean()), 1e-4),
        v_body=np.array([(w or nothing).v_body for w in wheels]) if has_wheels else None,
        sigma_v_body=np.array([(w or nothing).sigma for w in wheels]) if has_wheels else None,
    )
    return Window(states, [k.link for k in keyframes[1:] if k.link is not None], tracks, prior)


def _longest(tracks: WindowTracks) -> WindowTracks:
    """At most MAX_TRACKS tracks, those with most views."""
    order = np.argsort(-tracks.seen.sum(axis=1), kind="stable")[:MAX_TRACKS]
    order = np.sort(order)
    return WindowTracks(tracks.ids[order], tracks.uv_px[order], tracks.xy[order], tracks.seen[order])
