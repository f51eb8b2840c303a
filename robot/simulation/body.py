"""A skid-steer robot in a world of boxes: motor lag, slip, uneven floor, collisions, and hands that carry it away.

The motion is a smooth solution of an ODE, so rates and accelerations are exact derivatives and the IMU made from
them integrates back to the trajectory.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from robot.simulation.calibration.waving import WavedRig
from robot.simulation.config import BodyParameters
from robot.simulation.world import World
from shared.geometry import FloatArray

TICK_RATE_HZ = 225.0
TICK_S = 1.0 / TICK_RATE_HZ
CARRY_HEIGHT_M = 0.45
CARRY_SPEED_M_S = 2.0
MIN_CARRY_S = 1.6
MAX_YAW_SPREAD = (-0.09, 0.07)  # of the yaw efficiency between drives: no carpet and no tiles go further
REST_SPEED = 1e-3  # m/s, rad/s
GRAB_S = 1.0  # a hand holds the wheels until they rest; the lag of the motors decays to nothing in it


@dataclass(frozen=True, slots=True, eq=False)
class MotionState:
    """True motion of the body (= IMU) at one instant. World frame: the simulated world's."""

    t_s: float
    p_world: FloatArray  # (3,) m
    R_world_body: FloatArray  # (3, 3)
    v_world: FloatArray  # (3,) m/s
    a_world: FloatArray  # (3,) m/s^2
    omega_body: FloatArray  # (3,) rad/s
    carried: float = 0.0  # 0 on the floor .. 1 held in a hand that covers the lens
    is_waved: bool = False  # held in a hand that leaves the lens free
    head: tuple[float, float] = (0.0, 0.0)  # rad, pan and tilt of the camera's head


@dataclass(slots=True)
class _Plane:
    """State of the ODE: position, heading, forward speed, yaw rate with their derivatives, distance rolled."""

    x: float
    y: float
    yaw: float
    v: float = 0.0
    a: float = 0.0
    w: float = 0.0
    b: float = 0.0  # d w / d t
    s: float = 0.0


class Body:
    """The platform; step() advances it by one tick."""

    def __init__(self, world: World, parameters: BodyParameters, start: tuple[float, float, float], seed: int) -> None:
        self._parameters = parameters
        rng = np.random.default_rng([seed, 11])
        self._boxes = CollisionBoxes(world)
        self._plane = _Plane(*start)
        self._ticks = 0
        self._jolt = 0.0  # m/s², forward, of what was run into in this tick, as the accelerometer feels it
        self._command = (0.0, 0.0)
        self._yaw_efficiency = 1.0
        if parameters.slip:
            spread = float(np.clip(parameters.yaw_efficiency_spread * rng.standard_normal(), *MAX_YAW_SPREAD))
            self._yaw_efficiency = parameters.yaw_efficiency + spread
        self._slip_phase = rng.uniform(0, 2 * np.pi, 3)
        self._bumps = _Bumps(parameters, rng)
        self._carry: _Carry | None = None
        self._grabbed: tuple[float, float, float, float] | None = None  # x, y, yaw, duration of the carry to come
        self._grabbed_ticks = 0
        self._wave: tuple[WavedRig, int, float] | None = None  # motion, tick of its begin, seconds
        self.is_blocked = False

    @property
    def pose(self) -> tuple[float, float, float]:
        """x m, y m, yaw rad on the floor plan."""
        return self._plane.x, self._plane.y, self._plane.yaw

    def command(self, linear_m_s: float, angular_rad_s: float) -> None:
        """What the motors are told from now on."""
        p = self._parameters
        self._command = (
            float(np.clip(linear_m_s, -p.max_linear_m_s, p.max_linear_m_s)),
            float(np.clip(angular_rad_s, -p.max_angular_rad_s, p.max_angular_rad_s)),
        )

    @property
    def is_carried(self) -> bool:
        return self._carry is not None or self._grabbed is not None or self._wave is not None

    def wave(self, rig: WavedRig, duration_s: float) -> None:
        """Somebody lifts the resting robot and waves it before a board. Raises ValueError where it does not rest."""
        if self.is_carried or max(abs(self._plane.v), abs(self._plane.w)) > REST_SPEED:
            raise ValueError("the robot is moving; let it rest before it is waved")
        self._wave = rig, self._ticks, duration_s

    def hijack(self, x_m: float, y_m: float, yaw_rad: float) -> float:
        """Somebody lifts the robot, carries it and puts it down with wheels at rest; returns for how long (s)."""
        if self._carry is not None or self._wave is not None:
            raise ValueError("the robot is being carried already")
        plane = self._plane
        distance = math.hypot(x_m - plane.x, y_m - plane.y)
        duration = max(MIN_CARRY_S, distance / CARRY_SPEED_M_S + 0.6)
        self._grabbed = (x_m, y_m, yaw_rad, duration)
        return duration + GRAB_S

    def _lift(self, x_m: float, y_m: float, yaw_rad: float, duration: float) -> _Carry:
        """The wheels have come to rest in somebody's hands: now up."""
        plane = self._plane
        plane.v = plane.a = plane.w = plane.b = 0.0
        turn = (yaw_rad - plane.yaw + math.pi) % (2 * math.pi) - math.pi
        heave, roll, pitch = (value for value, _, _ in self._bumps.at(plane.s, 0.0, 0.0))
        rest = (self._parameters.imu_height_m + heave, roll, pitch)
        self._carry = _Carry(replace(plane), (x_m, y_m, plane.yaw + turn), duration, rest)
        self._grabbed, self._grabbed_ticks = None, 0
        return self._carry

    def step(self) -> MotionState:
        """Advance by TICK_S and return the motion at the new instant."""
        self._ticks += 1
        self._jolt = 0.0
        if self._wave is not None:
            return self._step_waved(*self._wave)
        if self._carry is not None:
            return self._step_carried(self._carry)
        plane = self._plane
        if self._grabbed is not None:
            self._grabbed_ticks += 1
            if self._grabbed_ticks * TICK_S >= GRAB_S:
                return self._step_carried(self._lift(*self._grabbed))
        before = (plane.v, plane.w)
        self._integrate()
        self._collide(before)
        return self.state()

    def _step_waved(self, rig: WavedRig, begin: int, duration_s: float) -> MotionState:
        t_s = (self._ticks - begin) * TICK_S
        if t_s >= duration_s:
            self._wave = None
            return self.state()
        motion = rig.at(np.array([t_s]))
        return MotionState(
            self._ticks * TICK_S,
            motion.p_world[0],
            motion.R_world_body[0],
            motion.v_world[0],
            motion.a_world[0],
            motion.omega_body[0],
            is_waved=True,
        )

    def state(self) -> MotionState:
        p = self._plane
        c, s = math.cos(p.yaw), math.sin(p.yaw)
        icr = self._parameters.icr_offset_m if self._parameters.slip else 0.0
        lateral, lateral_rate = icr * p.w, icr * p.b  # the IMU in front of the turning centre swings sideways
        ax, ay = p.a + self._jolt - p.w * lateral, lateral_rate + p.w * p.v
        speed, speed_rate = _rolling_speed(p)
        z, roll, pitch = self._bumps.at(p.s, speed, speed_rate)
        R = _rotation(p.yaw, pitch[0], roll[0])
        return MotionState(
            t_s=self._ticks * TICK_S,
            p_world=np.array([p.x, p.y, self._parameters.imu_height_m + z[0]]),
            R_world_body=R,
            v_world=np.array([c * p.v - s * lateral, s * p.v + c * lateral, z[1]]),
            a_world=np.array([c * ax - s * ay, s * ax + c * ay, z[2]]),
            omega_body=_body_rates(p.w, pitch, roll),
        )

    def _integrate(self) -> None:
        """One classical Runge-Kutta step of the ODE."""
        p, h = self._plane, TICK_S
        y0 = (p.x, p.y, p.yaw, p.v, p.a, p.w, p.b, p.s)
        targets = self._targets()
        k1 = self._slope(y0, targets)
        k2 = self._slope([y + 0.5 * h * k for y, k in zip(y0, k1, strict=True)], targets)
        k3 = self._slope([y + 0.5 * h * k for y, k in zip(y0, k2, strict=True)], targets)
        k4 = self._slope([y + h * k for y, k in zip(y0, k3, strict=True)], targets)
        p.x, p.y, p.yaw, p.v, p.a, p.w, p.b, p.s = [
            y + h / 6 * (a + 2 * b + 2 * c + d) for y, a, b, c, d in zip(y0, k1, k2, k3, k4, strict=True)
        ]

    def _targets(self) -> tuple[float, float]:
        """Speeds the wheels reach for the present command, slip included."""
        linear, angular = (0.0, 0.0) if self._grabbed is not None else self._command
        if not self._parameters.slip:
            return linear, angular
        s = self._plane.s
        waves = math.sin(1.3 * s + self._slip_phase[0]) + math.sin(2.9 * s + self._slip_phase[1])
        yaw_efficiency = self._yaw_efficiency * (1.0 + self._parameters.yaw_waves * waves)
        return linear * self._parameters.linear_efficiency, angular * yaw_efficiency

    def _slope(self, y: Sequence[float], targets: tuple[float, float]) -> tuple[float, ...]:
        _x, _y, yaw, v, a, w, b, _s = y
        lag = self._parameters.lag_s
        lateral = (self._parameters.icr_offset_m if self._parameters.slip else 0.0) * w
        c, s = math.cos(yaw), math.sin(yaw)
        return (
            c * v - s * lateral,
            s * v + c * lateral,
            w,
            a,
            (targets[0] - v - 2 * lag * a) / lag**2,
            b,
            (targets[1] - w - 2 * lag * b) / lag**2,
            math.sqrt(v * v + (0.15 * w) ** 2 + _SPEED_EPS**2) - _SPEED_EPS,
        )

    def _collide(self, before: tuple[float, float]) -> None:
        """Push the robot out of what it touches and take the speed into it away."""
        p = self._plane
        push = self._boxes.push_out(p.x, p.y, self._parameters.radius_m)
        self.is_blocked = push is not None
        if push is None:
            return
        nx, ny = (push / max(1e-12, float(np.hypot(*push)))).tolist()
        push_x, push_y = push.tolist()  # NumPy's numbers would slow down all that is computed from them
        p.x, p.y = p.x + push_x, p.y + push_y
        c, s = math.cos(p.yaw), math.sin(p.yaw)
        into = p.v * (c * nx + s * ny)  # speed along the outward normal; negative runs into the wall
        if into < 0:
            p.v -= into * (c * nx + s * ny)
            p.a = 0.0  # motors that are stopped build up their speed anew
            self._jolt = float(np.clip((p.v - before[0]) / TICK_S, -60.0, 60.0))

    def _step_carried(self, carry: _Carry) -> MotionState:
        state = carry.state(self._ticks * TICK_S)
        p = self._plane
        p.x, p.y, p.yaw = float(state.p_world[0]), float(state.p_world[1]), carry.yaw
        if carry.is_done:
            p.x, p.y, p.yaw = carry.target
            self._carry = None
        return state


_SPEED_EPS = 1e-3


def _rolling_speed(p: _Plane) -> tuple[float, float]:
    """Speed of the wheels over the floor and its rate; both vanish smoothly at rest."""
    root = math.sqrt(p.v * p.v + (0.15 * p.w) ** 2 + _SPEED_EPS**2)
    return root - _SPEED_EPS, (p.v * p.a + 0.15**2 * p.w * p.b) / root


def _rotation(yaw: float, pitch: float, roll: float) -> FloatArray:
    """R_world_body = Rz(yaw) Ry(pitch) Rx(roll)."""
    cy, sy, cp, sp, cr, sr = (f(a) for a in (yaw, pitch, roll) for f in (math.cos, math.sin))
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def _body_rates(yaw_rate: float, pitch: tuple[float, ...], roll: tuple[float, ...]) -> FloatArray:
    """Angular velocity (3,) rad/s in body axes from Euler angles and their rates."""
    sp, cp, sr, cr = math.sin(pitch[0]), math.cos(pitch[0]), math.sin(roll[0]), math.cos(roll[0])
    return np.array([roll[1] - yaw_rate * sp, pitch[1] * cr + yaw_rate * cp * sr, -pitch[1] * sr + yaw_rate * cp * cr])


class _Bumps:
    """Heave, roll and pitch as smooth functions of the distance rolled."""

    def __init__(self, parameters: BodyParameters, rng: np.random.Generator) -> None:
        scale = 1.0 if parameters.wobble else 0.0
        self._k = 2 * np.pi / np.array([0.65, 0.31, 0.17])  # rad/m
        share = np.array([0.6, 0.3, 0.12])
        amplitudes = np.array([parameters.heave_mm * 1e-3, *[math.radians(parameters.wobble_deg)] * 2])
        amplitude = scale * amplitudes[:, None] * share  # (3 motions, 3 waves)
        self._phase = rng.uniform(0, 2 * np.pi, (3, 3))
        self._factors = np.stack([amplitude, amplitude * self._k, amplitude * self._k**2])
        self._waves = np.empty((3, 3, 3))  # sine, cosine, sine

    def at(self, s: float, speed: float, speed_rate: float) -> list[tuple[float, float, float]]:
        """Value, rate and acceleration of heave (m), roll and pitch (rad)."""
        argument, waves = self._k * s + self._phase, self._waves
        waves[2] = np.sin(argument, out=waves[0])
        np.cos(argument, out=waves[1])
        found = (self._factors * waves).sum(2).tolist()  # along the way: value, slope, and bend downwards
        return [
            (value, slope * speed, -bend * speed**2 + slope * speed_rate)
            for value, slope, bend in zip(*found, strict=True)
        ]


def _minimum_jerk(f: float, duration: float) -> tuple[float, float, float]:
    """Progress 0..1 at share f of a movement, its rate and acceleration. Source: Flash and Hogan, 1985, eq. 3."""
    f = min(max(f, 0.0), 1.0)
    return (
        f**3 * (10 - 15 * f + 6 * f**2),
        30 * f**2 * (1 - f) ** 2 / duration,
        60 * f * (1 - f) * (1 - 2 * f) / duration**2,
    )


@dataclass(slots=True)
class _Carry:
    """Lift, carry and put down along a smooth path; the hand covers the lens on the way."""

    origin: _Plane
    target: tuple[float, float, float]
    duration_s: float
    rest: tuple[float, float, float]  # height m, roll rad, pitch rad on the floor, before and after
    elapsed_s: float = 0.0
    yaw: float = 0.0  # as last asked

    @property
    def is_done(self) -> bool:
        return self.elapsed_s >= self.duration_s

    def state(self, t_s: float) -> MotionState:
        height_m, roll_rest, pitch_rest = self.rest
        self.elapsed_s += TICK_S
        f = self.elapsed_s / self.duration_s
        m, m1, m2 = _minimum_jerk(f, self.duration_s)
        up = f < 0.5
        half = self.duration_s / 2
        h, h1, h2 = _minimum_jerk(2 * f if up else 2 * (1 - f), half)
        h1 = h1 if up else -h1
        dx, dy = self.target[0] - self.origin.x, self.target[1] - self.origin.y
        turn = self.target[2] - self.origin.yaw
        self.yaw = self.origin.yaw + m * turn
        # Tilts in the hand and comes back level.
        tilt = 0.35
        pitch, roll = (pitch_rest + tilt * h, tilt * h1), (roll_rest - 0.6 * tilt * h, -0.6 * tilt * h1)
        return MotionState(
            t_s=t_s,
            p_world=np.array([self.origin.x + m * dx, self.origin.y + m * dy, height_m + CARRY_HEIGHT_M * h]),
            R_world_body=_rotation(self.yaw, pitch[0], roll[0]),
            v_world=np.array([m1 * dx, m1 * dy, CARRY_HEIGHT_M * h1]),
            a_world=np.array([m2 * dx, m2 * dy, CARRY_HEIGHT_M * h2]),
            omega_body=_body_rates(m1 * turn, pitch, roll),
            carried=float(np.clip((h - 0.15) / 0.25, 0.0, 1.0)),
        )


ROUNDING_M = 1e-9  # far more than what it makes of a distance
_CHUNK = 1024  # points per pass: keeps the arrays in the cache


class CollisionBoxes:
    """All solid boxes as arrays, for quick tests against a disc."""

    def __init__(self, world: World) -> None:
        obstacles = world.obstacles
        self._centre = np.array([[o.x_m, o.y_m] for o in obstacles]).reshape(-1, 2)
        self._half = np.array([[o.half_x_m, o.half_y_m] for o in obstacles]).reshape(-1, 2)
        yaw = np.array([o.yaw_rad for o in obstacles])
        self._cos, self._sin = np.cos(yaw), np.sin(yaw)
        # Where a disc was last found free, and how far off the nearest box was: no nearer than that way is one touched.
        self._was_clear = (0.0, 0.0, -math.inf)

    def clearance(self, p: FloatArray) -> FloatArray:
        """Distance (N,) m of points (N, 2) to the nearest box; negative inside."""
        if len(self._centre) == 0:
            return np.full(len(p), math.inf)
        nearest = np.empty(len(p))
        for first in range(0, len(p), _CHUNK):
            part = slice(first, first + _CHUNK)
            dx, dy = p[part, 0, None] - self._centre[:, 0], p[part, 1, None] - self._centre[:, 1]
            beyond_x = np.abs(self._cos * dx + self._sin * dy) - self._half[:, 0]
            beyond_y = np.abs(self._cos * dy - self._sin * dx) - self._half[:, 1]
            outside = np.sqrt(np.maximum(beyond_x, 0.0) ** 2 + np.maximum(beyond_y, 0.0) ** 2)
            nearest[part] = (outside + np.minimum(np.maximum(beyond_x, beyond_y), 0.0)).min(1)
        return nearest

    def push_out(self, x: float, y: float, radius: float) -> FloatArray | None:
        """Shift (2,) m that frees a disc from the boxes it overlaps, None where it overlaps none."""
        near_x, near_y, clearance = self._was_clear
        if math.hypot(x - near_x, y - near_y) < clearance - radius - ROUNDING_M:
            return None
        shift = np.zeros(2)
        for _ in range(4):  # a corner between two boxes needs a few rounds
            step = self._deepest(x + shift[0], y + shift[1], radius)
            if step is None:
                break
            shift += step
        return shift if shift.any() else None

    def _deepest(self, x: float, y: float, radius: float) -> FloatArray | None:
        dx, dy = x - self._centre[:, 0], y - self._centre[:, 1]
        lx, ly = self._cos * dx + self._sin * dy, -self._sin * dx + self._cos * dy
        qx, qy = (
            lx - np.clip(lx, -self._half[:, 0], self._half[:, 0]),
            ly - np.clip(ly, -self._half[:, 1], self._half[:, 1]),
        )
        distance = np.hypot(qx, qy)
        nearest = distance.min() if len(distance) else math.inf
        if nearest >= radius:
            self._was_clear = x, y, nearest
            return None
        i = int(np.argmin(distance))
        if distance[i] > 1e-9:
            nx, ny, depth = qx[i] / distance[i], qy[i] / distance[i], radius - distance[i]
        else:  # the centre itself is inside: leave by the nearest side
            gaps = self._half[i] - np.abs([lx[i], ly[i]])
            k = int(np.argmin(gaps))
            nx, ny = (math.copysign(1.0, lx[i]), 0.0) if k == 0 else (0.0, math.copysign(1.0, ly[i]))
            depth = radius + gaps[k]
        c, s = self._cos[i], self._sin[i]
        return depth * np.array([c * nx - s * ny, s * nx + c * ny])


PoseFunction = Callable[[float], FloatArray]  # time in s to T_world_body (4, 4)
