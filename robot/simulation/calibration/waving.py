"""How a hand waves a rig before a board: smooth, with exact rates and accelerations.

The camera circles about a point near the board's centre: it turns about three axes and moves so that the board
stays in view. All channels are sums of sines, hence every derivative is exact.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shared.geometry import FloatArray, skew

# The camera looks along the world's x, its image's x axis to the right (-y), its image's y axis down (-z).
R_WORLD_CAM_AHEAD = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
BANDS_HZ = ((0.12, 0.25), (0.3, 0.5), (0.6, 0.9))  # of each channel's three large sines
SHARES = (0.45, 0.35, 0.2)
TREMOR_HZ = (6.0, 9.0)
TREMOR_RAD, TREMOR_M = 5e-4, 1e-4  # of a hand that holds something


@dataclass(frozen=True, slots=True)
class Wave:
    """How far a hand waves: amplitudes of turning and, as shares of the distance, of moving."""

    turn_deg: tuple[float, float, float] = (22.0, 22.0, 25.0)  # yaw, pitch, roll of the camera
    distance_share: float = 0.22  # nearer and farther
    aside_share: float = 0.12  # the board's centre leaves the image's centre by this much of the distance


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """True motion of the body (= IMU) at N instants. World frame: z up, origin at the board's centre."""

    t_s: FloatArray  # (N,)
    p_world: FloatArray  # (N, 3) m
    R_world_body: FloatArray  # (N, 3, 3)
    v_world: FloatArray  # (N, 3) m/s
    a_world: FloatArray  # (N, 3) m/s^2
    omega_body: FloatArray  # (N, 3) rad/s

    @property
    def T_world_body(self) -> FloatArray:
        """(N, 4, 4)."""
        T = np.tile(np.eye(4), (len(self.t_s), 1, 1))
        T[:, :3, :3], T[:, :3, 3] = self.R_world_body, self.p_world
        return T


class _Channel:
    """A quantity that swings about its middle: value, rate and acceleration at given times."""

    def __init__(self, middle: float, amplitude: float, tremor: float, rng: np.random.Generator) -> None:
        f = np.array([rng.uniform(*band) for band in (*BANDS_HZ, TREMOR_HZ)])
        self._omega = 2 * np.pi * f
        self._amplitude = np.array([*(amplitude * share for share in SHARES), tremor])
        self._phase = rng.uniform(0, 2 * np.pi, len(f))
        self._middle = middle

    def at(self, t_s: FloatArray) -> FloatArray:
        """(3, N): value, rate, acceleration."""
        argument = np.multiply.outer(t_s, self._omega) + self._phase
        sine, cosine = np.sin(argument), np.cos(argument)
        value = self._middle + sine @ self._amplitude
        rate = cosine @ (self._amplitude * self._omega)
        return np.stack([value, rate, -sine @ (self._amplitude * self._omega**2)])


class WavedRig:
    """Camera and IMU, rigidly joined, in a hand before a board at `distance_m`."""

    def __init__(self, wave: Wave, distance_m: float, T_body_cam: FloatArray, rng: np.random.Generator) -> None:
        turn = np.radians(wave.turn_deg)
        self._turn = [_Channel(0.0, float(a), TREMOR_RAD if a else 0.0, rng) for a in turn]
        aside, tremor = wave.aside_share * distance_m, TREMOR_M if wave.distance_share else 0.0
        self._board = [  # the board's centre in camera coordinates
            _Channel(0.0, aside, tremor, rng),
            _Channel(0.0, 0.7 * aside, tremor, rng),
            _Channel(distance_m, wave.distance_share * distance_m, tremor, rng),
        ]
        self._R_cam_body = T_body_cam[:3, :3].T
        self._body_cam = -self._R_cam_body @ T_body_cam[:3, 3]  # the body's origin in camera coordinates

    def at(self, t_s: FloatArray) -> Motion:
        """The motion at times (N,)."""
        R, w, alpha = self._turning(t_s)
        q, dq, ddq = (np.stack(rows, axis=1) for rows in zip(*(c.at(t_s) for c in self._board), strict=True))
        s, ds, dds = self._body_cam - q, -dq, -ddq  # from the board's centre to the body, camera coordinates
        v = ds + np.cross(w, s)
        a = dds + 2 * np.cross(w, ds) + np.cross(alpha, s) + np.cross(w, np.cross(w, s))
        rotate = "nij,nj->ni"
        return Motion(
            t_s=t_s,
            p_world=np.einsum(rotate, R, s),
            R_world_body=R @ self._R_cam_body,
            v_world=np.einsum(rotate, R, v),
            a_world=np.einsum(rotate, R, a),
            omega_body=w @ self._R_cam_body,
        )

    def _turning(self, t_s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """R_world_cam = ahead * Ry(yaw) Rx(pitch) Rz(roll) with its rate and angular acceleration, camera axes."""
        (yaw, dyaw, ddyaw), (pitch, dpitch, ddpitch), (roll, droll, ddroll) = (c.at(t_s) for c in self._turn)
        e_x, e_y, e_z = np.eye(3)
        Ry, Rx, Rz = _about(e_y, yaw), _about(e_x, pitch), _about(e_z, roll)
        Rz_T = Rz.transpose(0, 2, 1)
        pitch_axis = Rz_T @ e_x  # (N, 3), the axes of yaw and pitch in camera coordinates
        yaw_axis = np.einsum("nij,njk,k->ni", Rz_T, Rx.transpose(0, 2, 1), e_y)
        w = yaw_axis * dyaw[:, None] + pitch_axis * dpitch[:, None] + e_z * droll[:, None]
        d_pitch_axis = -np.cross(e_z, pitch_axis) * droll[:, None]
        d_yaw_axis = -np.cross(e_z, yaw_axis) * droll[:, None] - np.cross(pitch_axis, yaw_axis) * dpitch[:, None]
        alpha = (
            yaw_axis * ddyaw[:, None]
            + d_yaw_axis * dyaw[:, None]
            + pitch_axis * ddpitch[:, None]
            + d_pitch_axis * dpitch[:, None]
            + e_z * ddroll[:, None]
        )
        return R_WORLD_CAM_AHEAD @ Ry @ Rx @ Rz, w, alpha


def _about(axis: FloatArray, angle: FloatArray) -> FloatArray:
    """Rotations (N, 3, 3) about one axis (3,) by angles (N,). Thesis eq. B.2 (Rodrigues)."""
    K = skew(axis)
    return np.asarray(
        np.eye(3) + np.sin(angle)[:, None, None] * K + (1 - np.cos(angle))[:, None, None] * (K @ K), dtype=np.float64
    )
