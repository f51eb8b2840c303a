"""How a hand waves a rig before a board: smooth, with exact rates and accelerations.

The camera circles about a point near the board's centre: it turns about three axes and moves so that the board
stays in view. All channels are sums of sines, hence every derivative is exact.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shared.geometry import FloatArray, se3, skew, transform

# The camera looks along the world's x, its image's x axis to the right (-y), its image's y axis down (-z).
R_WORLD_CAM_AHEAD = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
BANDS_HZ = ((0.12, 0.25), (0.3, 0.5), (0.6, 0.9))  # of each channel's three large sines
SHARES = (0.45, 0.35, 0.2)
TREMOR_HZ = (6.0, 9.0)
TREMOR_RAD, TREMOR_M = 5e-4, 1e-4  # of a hand that holds something
FADE_S = 2.0  # from rest to waving and back


@dataclass(frozen=True, slots=True)
class Wave:
    """How far a hand waves: amplitudes of turning and, as shares of the distance, of moving."""

    turn_deg: tuple[float, float, float] = (22.0, 22.0, 25.0)  # yaw, pitch, roll of the camera
    distance_share: float = 0.22  # nearer and farther
    aside_share: float = 0.12  # the board's centre leaves the image's centre by this much of the distance


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """True motion of the body (= IMU) at N instants. World frame: z up."""

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
    """A quantity that swings about its middle."""

    def __init__(self, middle: float, amplitude: float, tremor: float, rng: np.random.Generator) -> None:
        f = np.array([rng.uniform(*band) for band in (*BANDS_HZ, TREMOR_HZ)])
        self._omega = 2 * np.pi * f
        self._amplitude = np.array([*(amplitude * share for share in SHARES), tremor])
        self._phase = rng.uniform(0, 2 * np.pi, len(f))
        self.middle = middle

    def swing(self, t_s: FloatArray) -> FloatArray:
        """(3, N): departure from the middle, its rate and acceleration."""
        argument = np.multiply.outer(t_s, self._omega) + self._phase
        sine, cosine = np.sin(argument), np.cos(argument)
        value = sine @ self._amplitude
        rate = cosine @ (self._amplitude * self._omega)
        return np.stack([value, rate, -sine @ (self._amplitude * self._omega**2)])


class WavedRig:
    """Camera and IMU, rigidly joined, in a hand before a board whose centre is `distance_m` ahead of the camera."""

    def __init__(
        self,
        wave: Wave,
        distance_m: float,
        T_body_cam: FloatArray,
        rng: np.random.Generator,
        T_world_cam: FloatArray | None = None,
        duration_s: float | None = None,
    ) -> None:
        """The rig is waved about the pose T_world_cam (4, 4); None: level, with the board's centre at the origin.

        With duration_s it rests in that pose at the times 0 and duration_s; otherwise it is always being waved.
        """
        middle = se3(R_WORLD_CAM_AHEAD, np.array([-distance_m, 0.0, 0.0])) if T_world_cam is None else T_world_cam
        self._R_middle = middle[:3, :3]
        self._board_world = transform(middle, np.array([0.0, 0.0, distance_m]))
        self._duration_s = duration_s
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
        q, dq, ddq = (np.stack(rows, axis=1) for rows in zip(*(self._at(c, t_s) for c in self._board), strict=True))
        s, ds, dds = self._body_cam - q, -dq, -ddq  # from the board's centre to the body, camera coordinates
        v = ds + np.cross(w, s)
        a = dds + 2 * np.cross(w, ds) + np.cross(alpha, s) + np.cross(w, np.cross(w, s))
        rotate = "nij,nj->ni"
        return Motion(
            t_s=t_s,
            p_world=self._board_world + np.einsum(rotate, R, s),
            R_world_body=R @ self._R_cam_body,
            v_world=np.einsum(rotate, R, v),
            a_world=np.einsum(rotate, R, a),
            omega_body=w @ self._R_cam_body,
        )

    def _at(self, channel: _Channel, t_s: FloatArray) -> FloatArray:
        """(3, N): the channel's value, rate and acceleration, faded in and out."""
        swing = channel.swing(t_s)
        if self._duration_s is not None:
            (f, df, ddf), (x, dx, ddx) = _fade(t_s, self._duration_s), swing
            swing = np.stack([f * x, df * x + f * dx, ddf * x + 2 * df * dx + f * ddx])
        swing[0] += channel.middle
        return swing

    def _turning(self, t_s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """R_world_cam = middle * Ry(yaw) Rx(pitch) Rz(roll) with its rate and angular acceleration, camera axes."""
        (yaw, dyaw, ddyaw), (pitch, dpitch, ddpitch), (roll, droll, ddroll) = (self._at(c, t_s) for c in self._turn)
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
        return self._R_middle @ Ry @ Rx @ Rz, w, alpha


def _fade(t_s: FloatArray, duration_s: float) -> FloatArray:
    """(3, N): share 0 to 1, its rate and acceleration; 0 at both ends. Source: Flash and Hogan, 1985, eq. 3."""
    begins = t_s < duration_s / 2
    f = np.clip(np.where(begins, t_s, duration_s - t_s) / FADE_S, 0.0, 1.0)
    rate = 30 * f**2 * (1 - f) ** 2 / FADE_S
    return np.stack(
        [f**3 * (10 - 15 * f + 6 * f**2), np.where(begins, rate, -rate), 60 * f * (1 - f) * (1 - 2 * f) / FADE_S**2]
    )


def _about(axis: FloatArray, angle: FloatArray) -> FloatArray:
    """Rotations (N, 3, 3) about one axis (3,) by angles (N,). Thesis eq. B.2 (Rodrigues)."""
    K = skew(axis)
    return np.asarray(
        np.eye(3) + np.sin(angle)[:, None, None] * K + (1 - np.cos(angle))[:, None, None] * (K @ K), dtype=np.float64
    )
