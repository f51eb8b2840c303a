"""From sensor data to a filter's first state: given, at rest, on wheels, or in motion (docs/slam.md, sec. 8)."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from shared.calibration import ImuNoise
from shared.geometry import FloatArray, IntArray, skew, upright, yaw_rotation
from station.model.frames import ImuBatch
from station.motion.error_coordinates import ErrorKind
from station.motion.imu_buffer import ImuBuffer
from station.slam.mapping.inertial_bundle import N
from station.slam.ukf.filter.constraints import BodyVelocity
from station.slam.ukf.filter.state import CORE, PHI, XI_V, XI_X, FilterState, add_clone, initial_state
from station.slam.ukf.start.motion_start import MotionStart, StartConfig, start_in_motion
from station.vision.camera_model import CameraModel
from station.vision.klt import TrackedFrame

SIGMA_FRAME = 1e-4  # rad and m: position and yaw of a start are definitions
SIGMA_TILT_REST = 0.02  # rad: accelerometer bias leans the gravity that is measured
SIGMA_V_REST = 0.01  # m/s
SIGMA_TILT_ROLLING = 0.03  # rad: the floor, and what accelerating leans
SIGMA_V_ROLLING = 0.06  # m/s, per axis: wheels slip and skid


def driven_velocity(wheels: BodyVelocity, lag_m_s: float) -> FloatArray | None:
    """Body velocity (3,) with which a driven robot may start; None before its motors have followed their command.

    lag_m_s: by what the motors have still to make of a command the wheels may be off.
    """
    is_known = bool(np.isfinite(wheels.sigma).all()) and lag_m_s <= SIGMA_V_ROLLING
    return wheels.v_body if is_known else None


@dataclass(frozen=True, slots=True, eq=False)
class GivenState:
    """A state that somebody else knows, with standard deviations."""

    t_imu_ns: int
    R_world_body: FloatArray  # (3, 3)
    v_world: FloatArray  # (3,)
    x_world: FloatArray  # (3,)
    bias_gyro: FloatArray  # (3,)
    bias_accel: FloatArray  # (3,)
    sigma_tilt: float = 0.005
    sigma_v: float = 0.05
    sigma_bias_gyro: float = 0.01
    sigma_bias_accel: float = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class Anchor:
    """Where a new segment begins in the navigation's world, and what is still known."""

    x_world: FloatArray  # (3,)
    yaw_rad: float
    bias: FloatArray | None  # (6,)


ORIGIN = Anchor(np.zeros(3), 0.0, None)


@dataclass(frozen=True, slots=True, eq=False)
class WaitingFrame:
    index: int
    t_imu_ns: int
    tracked: TrackedFrame
    v_wheels: FloatArray | None = None  # (3,) body frame; None unless the motors drive a robot on wheels
    looks_ahead: bool = True  # the camera is where the body's motion takes it


class Starter:
    """Collects frames until a start is possible."""

    def __init__(
        self, camera: CameraModel, noise: ImuNoise, gravity: float, config: StartConfig, kind: ErrorKind
    ) -> None:
        self._camera, self._noise, self._gravity = camera, noise, gravity
        self._config, self._kind = config, kind
        self._frames: deque[WaitingFrame] = deque()
        self._next_attempt_ns = 0
        self._reason = "needs images"

    def reset(self) -> None:
        self._frames.clear()

    def try_start(
        self, frame: WaitingFrame, imu: ImuBuffer, is_still: bool, anchor_at: Callable[[int], Anchor]
    ) -> tuple[FilterState, MotionStart | None] | str:
        """Take a frame in; a state at its time, or what is missing, in words.

        anchor_at: where the robot was at an IMU time, ns.
        """
        config = self._config
        anchor = anchor_at(frame.t_imu_ns)
        if self._frames and len(np.intersect1d(self._frames[-1].tracked.ids, frame.tracked.ids)) < 8:
            self._frames.clear()  # nothing connects it with what was seen before
        self._frames.append(frame)
        while frame.t_imu_ns - self._frames[0].t_imu_ns > config.max_window_s * 1e9:
            self._frames.popleft()
        if is_still:
            samples = imu.samples(frame.t_imu_ns - int(config.still_s * 1e9), frame.t_imu_ns)
            state = state_at_rest(frame.t_imu_ns, samples, self._noise, self._gravity, self._kind, anchor)
            self._frames.clear()
            return state, None
        if frame.v_wheels is not None:
            return self._start_rolling(frame, frame.v_wheels, imu, anchor)
        waited = (frame.t_imu_ns - self._frames[0].t_imu_ns) * 1e-9
        if waited < config.min_window_s:
            more_s = config.min_window_s - waited
            return f"needs {more_s:.1f} s more of images that overlap, or {config.still_s} s at rest"
        if not all(f.looks_ahead for f in self._frames):
            return "needs the head to look straight ahead, the wheels to drive, or all to rest"
        if frame.t_imu_ns < self._next_attempt_ns:
            return self._reason
        self._next_attempt_ns = frame.t_imu_ns + int(config.attempt_every_s * 1e9)
        frames = list(self._frames)
        found = start_in_motion(
            self._camera,
            self._noise,
            self._gravity,
            imu,
            [f.tracked for f in frames],
            [f.index for f in frames],
            [f.t_imu_ns for f in frames],
            config,
            anchor.bias,
        )
        if isinstance(found, str):
            self._reason = found
            return found
        self._frames.clear()
        return state_in_motion(found, self._kind, anchor_at(int(found.t_imu_ns[0]))), found

    def _start_rolling(
        self, frame: WaitingFrame, v_wheels: FloatArray, imu: ImuBuffer, anchor: Anchor
    ) -> tuple[FilterState, None] | str:
        """Start from what is known of a robot that its motors drive over a floor; or what is missing, in words.

        A window of images says little here: one that drives straight on hardly shows its scale.
        """
        config = self._config
        window_ns = int(config.rolling_s * 1e9)
        samples = imu.samples(frame.t_imu_ns - window_ns, frame.t_imu_ns)
        if len(samples) < 2 or samples.t_robot_ns[-1] - samples.t_robot_ns[0] < 0.8 * window_ns:
            return f"needs {config.rolling_s} s of IMU samples without a gap"
        if frame.tracked.num_tracked < config.min_rolling_features:
            return "needs images with something to follow"
        accel = samples.accel_imu.mean(axis=0)
        size = float(np.linalg.norm(accel))
        is_level = accel[2] > size * np.cos(config.max_rolling_tilt)
        if not is_level or abs(size - self._gravity) > config.max_rolling_accel:
            return "needs to stand on its wheels"
        self._frames.clear()
        return state_rolling(frame.t_imu_ns, accel, v_wheels, self._kind, anchor), None


def state_rolling(
    t_imu_ns: int, accel: FloatArray, v_wheels: FloatArray, kind: ErrorKind, anchor: Anchor
) -> FilterState:
    """The state of a robot that drives: velocity from its wheels, upright as far as a floor is level.

    Args:
        accel: (3,) mean reading. Accelerating leans it, a slope or a mounting leans the floor's vertical: half of each.
        v_wheels: (3,) body frame.
    """
    lean = accel / np.linalg.norm(accel) + np.array([0.0, 0.0, 1.0])
    R = yaw_rotation(anchor.yaw_rad) @ upright(lean, np.eye(3))
    bias = np.zeros(6) if anchor.bias is None else anchor.bias
    given = GivenState(
        t_imu_ns=t_imu_ns,
        R_world_body=R,
        v_world=R @ v_wheels,
        x_world=anchor.x_world.copy(),
        bias_gyro=bias[:3],
        bias_accel=bias[3:],
        sigma_tilt=SIGMA_TILT_ROLLING,
        sigma_v=SIGMA_V_ROLLING,
        sigma_bias_gyro=0.02 if anchor.bias is None else 0.005,
        sigma_bias_accel=0.1 if anchor.bias is None else 0.05,
    )
    return state_from_given(given, kind)


def state_at_rest(
    t_imu_ns: int, imu: ImuBatch, noise: ImuNoise, gravity: float, kind: ErrorKind, anchor: Anchor
) -> FilterState:
    """Gravity and gyro bias from a resting IMU. The accelerometer's bias along gravity shows, the rest does not."""
    gyro, accel = imu.gyro_imu.mean(axis=0), imu.accel_imu.mean(axis=0)
    bias_accel = np.zeros(3) if anchor.bias is None else anchor.bias[3:]
    up = (accel - bias_accel) / np.linalg.norm(accel - bias_accel)
    bias_accel = bias_accel + up * (float(np.linalg.norm(accel - bias_accel)) - gravity)
    R = yaw_rotation(anchor.yaw_rad) @ upright(up, np.eye(3))
    tilt = SIGMA_TILT_REST if anchor.bias is None else 0.5 * SIGMA_TILT_REST
    count = max(len(imu), 1)
    sigma_gyro = max(3.0 * noise.gyro_density * np.sqrt(noise.rate_hz / count), 1e-4)
    S = np.zeros((CORE, CORE))
    sigma_phi = np.diag([tilt, tilt, SIGMA_FRAME])
    S[PHI, PHI] = sigma_phi
    # What the accelerometer reads is known: a tilt must come with the bias that hides it.
    # accel = R^T g + b: d(R^T g) = R^T [g]x phi for R = exp(phi) R_mean, so b moves by minus that.
    g = np.array([0.0, 0.0, gravity])
    S[3:6, PHI] = -(R.T @ skew(g)) @ sigma_phi
    S[3:6, 3:6] = np.eye(3) * max(3.0 * noise.accel_density, 0.02)
    S[0:3, 0:3] = np.eye(3) * sigma_gyro
    S[XI_V, XI_V] = np.eye(3) * SIGMA_V_REST
    S[XI_X, XI_X] = np.eye(3) * SIGMA_FRAME
    if kind is ErrorKind.RIGHT:  # xi_x = dx - phi x x
        S[XI_X, PHI] = skew(anchor.x_world) @ sigma_phi
    elif kind is ErrorKind.LEFT:
        S[PHI] = R.T @ S[PHI]
        S[XI_V], S[XI_X] = R.T @ S[XI_V], R.T @ S[XI_X]
    return initial_state(t_imu_ns, R, np.zeros(3), anchor.x_world.copy(), gyro, bias_accel, S)


def state_from_given(given: GivenState, kind: ErrorKind) -> FilterState:
    """A filter state with the given uncertainty."""
    R = given.R_world_body
    S = np.zeros((CORE, CORE))
    S[0:3, 0:3] = np.eye(3) * given.sigma_bias_gyro
    S[3:6, 3:6] = np.eye(3) * given.sigma_bias_accel
    phi = np.diag([given.sigma_tilt, given.sigma_tilt, SIGMA_FRAME])
    S[PHI, PHI] = phi
    S[XI_V, XI_V] = np.eye(3) * given.sigma_v
    S[XI_X, XI_X] = np.eye(3) * SIGMA_FRAME
    if kind is ErrorKind.RIGHT:
        S[XI_V, PHI] = skew(given.v_world) @ phi
        S[XI_X, PHI] = skew(given.x_world) @ phi
    elif kind is ErrorKind.LEFT:
        S[PHI], S[XI_V], S[XI_X] = R.T @ S[PHI], R.T @ S[XI_V], R.T @ S[XI_X]
    return initial_state(
        given.t_imu_ns, R, given.v_world, given.x_world, given.bias_gyro, given.bias_accel, S
    )  # fmt: skip


def state_in_motion(start: MotionStart, kind: ErrorKind, anchor: Anchor) -> FilterState:
    """Core and cloned poses from a solved window, whose first pose is at `anchor`, with their joint covariance."""
    states, cov = start.solution.states, start.solution.covariance
    turn = yaw_rotation(anchor.yaw_rad)
    R, v = turn @ states.R, states.v @ turn.T
    x = (states.x - states.x[0]) @ turn.T + anchor.x_world
    K = len(x)
    last = N * (K - 1)
    # Columns of the window's unknowns (phi, v, x added, biases; world frame turned) for each row of the filter's state.
    pick: list[IntArray] = [np.arange(last + 9, last + 15), np.arange(last, last + 9)]
    pick += [np.concatenate([np.arange(N * k, N * k + 3), np.arange(N * k + 6, N * k + 9)]) for k in range(K - 1)]
    index = np.concatenate(pick)
    P = cov[np.ix_(index, index)]
    T = np.eye(len(index))
    _error_map(T, kind, turn, R[-1], [v[-1], x[-1]], 6)
    for k in range(K - 1):
        _error_map(T, kind, turn, R[k], [x[k]], CORE + 6 * k)
    P = T @ P @ T.T
    scale = np.sqrt(np.diag(P))
    correlation = P / np.outer(scale, scale) + 1e-9 * np.eye(len(P))
    S = scale[:, None] * np.linalg.cholesky(correlation)
    bias = states.bias[-1]
    state = initial_state(int(start.t_imu_ns[-1]), R[-1], v[-1], x[-1], bias[:3], bias[3:], S[:CORE])
    state = FilterState(
        t_imu_ns=state.t_imu_ns,
        R=state.R,
        v=state.v,
        x=state.x,
        bias_gyro=state.bias_gyro,
        bias_accel=state.bias_accel,
        S=S,
        wheels=state.wheels,
        head=state.head,
        omega_body=states.omega[-1],
        clone_R=R[:-1],
        clone_x=x[:-1],
        clone_v=v[:-1],
        clone_omega=states.omega[:-1],
        clone_frame=start.frame_index[:-1].astype(np.int64),
        landmark_id=state.landmark_id,
        landmark_p=state.landmark_p,
    )
    return add_clone(state, int(start.frame_index[-1]))


def _error_map(
    T: FloatArray, kind: ErrorKind, turn: FloatArray, R: FloatArray, vectors: list[FloatArray], at: int
) -> None:
    """Rows of T that turn (phi, added vectors) of the window into the filter's error coordinates of one pose."""
    phi = slice(at, at + 3)
    T[phi, phi] = turn
    for i, vector in enumerate(vectors):
        rows = slice(at + 3 + 3 * i, at + 6 + 3 * i)
        T[rows, rows] = turn
        if kind is ErrorKind.RIGHT:
            T[rows, phi] = skew(vector) @ turn
        elif kind is ErrorKind.LEFT:
            T[rows, rows] = R.T @ turn
    if kind is ErrorKind.LEFT:
        T[phi, phi] = R.T @ turn
