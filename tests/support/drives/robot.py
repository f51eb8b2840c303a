"""A simulated robot on a plan: what it sends, and where it truly was."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from robot.simulation.body import Body, MotionState
from robot.simulation.config import Faults, SimulationConfig
from robot.simulation.driver import RouteDriver
from robot.simulation.imaging import SimulatedCamera
from robot.simulation.renderer import Renderer
from robot.simulation.sensors import ImuModel
from robot.simulation.trajectory import MotionHistory
from shared.calibration import Calibration
from shared.geometry import FloatArray
from station.model.frames import DriveSample, ImageFrame, ImuBatch
from station.model.navigation import Trajectory
from tests.support.drives.recorded import TrueHijack
from tests.support.drives.routes import Plan

START_NS = 1_000_000_000
REST_S = 1.5  # stands still before and after the drive
IMU_BATCH = 10
TURN_RAD_S = 1.5  # commanded while turning on the spot; wheels slip to a third of it
COMMAND_EVERY_TICKS = 15
TRUTH_EVERY_TICKS = 9  # 25 Hz
Sent = ImuBatch | DriveSample | ImageFrame


def no_faults(_t_s: float) -> Faults:
    return Faults()


class SimulatedRobot:
    """Drives a plan once; `sent` yields what the station receives."""

    def __init__(self, renderer: Renderer, built: Calibration, config: SimulationConfig, plan: Plan, seed: int) -> None:
        """`built`: its sensors as they are, which the renderer's camera is, too."""
        assert built.camera is not None and built.imu is not None
        self.plan, self._camera_built = plan, built.camera
        route = plan.route
        self.body = Body(renderer.world, config.body, (*route.points[0], route.start_yaw_rad), seed)
        self._imu = ImuModel(built.imu, config.imu, built.gravity, seed)
        self._camera = SimulatedCamera(renderer, built.camera, config.camera, seed)
        self._history = MotionHistory(keep_s=2.0)
        self._driver = _Driver(plan, self.body)
        self._truth: list[tuple[int, FloatArray]] = []
        self.hijack: TrueHijack | None = None

    @property
    def truth(self) -> Trajectory:
        """Of the whole drive so far; times are the IMU's."""
        return Trajectory(np.array([t for t, _ in self._truth]), np.stack([T for _, T in self._truth]))

    def true_at(self, t_ns: int) -> tuple[FloatArray, bool]:
        """T_world_body (4, 4) at a moment of the last two seconds (IMU's clock), and whether a hand holds the robot."""
        grabbed = self.hijack is not None and self.hijack.grabbed_ns <= t_ns < self.hijack.put_down_ns
        return self._history.pose((t_ns - START_NS) / 1e9), grabbed

    def sent(self, frame_rate_hz: float, faults_at: Callable[[float], Faults] = no_faults) -> Iterator[Sent]:
        """All of the drive. Frames come once their last row is read, stamped by the camera's clock."""
        camera = self._camera_built
        state, ticks, next_frame_s, index = self.body.state(), 0, 0.2, 0
        batch: list[tuple[int, FloatArray, FloatArray]] = []
        while not self._driver.has_ended(state.t_s):
            self._history.append(state)
            t_ns = START_NS + round(state.t_s * 1e9)
            if ticks % TRUTH_EVERY_TICKS == 0:
                self._truth.append((t_ns, self._history.pose(state.t_s)))
            m = self._imu.measure(state)
            batch.append((t_ns, m.gyro_imu, m.accel_imu))
            if len(batch) == IMU_BATCH:
                yield ImuBatch(*(np.array(column) for column in zip(*batch, strict=True)))
                batch = []
            if state.t_s - next_frame_s > camera.line_delay_s * camera.height + 0.02:
                carried = self._history.carried(next_frame_s)
                exposure = self._camera.expose(self._history.pose, next_frame_s, faults_at(next_frame_s), carried)
                stamp = START_NS + round((next_frame_s - camera.time_shift_s) * 1e9)
                yield ImageFrame(index, stamp, round(exposure.exposure_s * 1e9), exposure.jpeg)
                index += 1
                next_frame_s += 1.0 / frame_rate_hz
            if self._driver.grabs_now(state.t_s):
                self.hijack = self._driver.grab(state.t_s)
            if ticks % COMMAND_EVERY_TICKS == 0 and state.t_s > REST_S:
                command = self._driver.command(state)
                self.body.command(*command)
                yield DriveSample(t_ns, *command)
            state = self.body.step()
            ticks += 1


class _Driver:
    """The person at the joystick, and whoever takes the robot away."""

    def __init__(self, plan: Plan, body: Body) -> None:
        self._plan, self._body = plan, body
        self._before = RouteDriver(plan.route)
        self._after = RouteDriver(plan.hijack.then) if plan.hijack else None
        self._put_down_s = np.inf
        self._is_grabbed = False
        self._done_s = np.inf

    def has_ended(self, t_s: float) -> bool:
        if self._driver.is_done and (self._plan.hijack is None or self._is_grabbed):
            self._done_s = min(self._done_s, t_s)
        return t_s >= min(self._plan.seconds, self._done_s + REST_S)

    @property
    def _driver(self) -> RouteDriver:
        return self._after if self._is_grabbed and self._after is not None else self._before

    def grabs_now(self, t_s: float) -> bool:
        return self._plan.hijack is not None and not self._is_grabbed and t_s >= self._plan.hijack.at_s

    def grab(self, t_s: float) -> TrueHijack:
        hijack = self._plan.hijack
        assert hijack is not None
        self._is_grabbed = True
        self._put_down_s = t_s + self._body.hijack(*hijack.target)
        grabbed_ns, put_down_ns = (START_NS + round(s * 1e9) for s in (t_s, self._put_down_s))
        return TrueHijack(grabbed_ns, put_down_ns, hijack.to_unmapped)

    def command(self, state: MotionState) -> tuple[float, float]:
        """Forward m/s and turn rad/s."""
        hijack = self._plan.hijack
        if hijack is not None and self._is_grabbed and state.t_s > hijack.at_s + hijack.goes_on_s:
            since_put_down_s = state.t_s - self._put_down_s
            if since_put_down_s < 1.0:
                return 0.0, 0.0
            if since_put_down_s < 1.0 + hijack.looks_around_s:
                return 0.0, TURN_RAD_S
            assert self._after is not None
            driver = self._after
        else:
            driver = self._before
        told = driver.command(*self._body.pose, float(state.omega_body[2]))
        return told.linear_m_s, told.angular_rad_s
