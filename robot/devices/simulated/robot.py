"""The simulated robot in real time: one thread moves it with the monotonic clock, one takes pictures."""

from __future__ import annotations

import logging
import math
import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import Protocol

import numpy as np

from robot.devices.mailbox import Mailbox
from robot.devices.ports import BatteryState, CapturedDepth, CapturedFrame, ImuReading
from robot.devices.simulated.rendering import CameraProcess, FrameRequest
from robot.devices.simulated.truth_log import TruthLog
from robot.simulation.body import TICK_RATE_HZ, TICK_S, Body, MotionState
from robot.simulation.calibration.board import Board, board_ahead
from robot.simulation.calibration.overlay import HungBoard
from robot.simulation.calibration.waving import Wave, WavedRig
from robot.simulation.config import Faults, SimulationConfig
from robot.simulation.construction import built_camera
from robot.simulation.recording import simulated_calibration
from robot.simulation.routes import FreeSpace, Route, plan_route
from robot.simulation.sensors import ImuModel
from robot.simulation.servos import Servos
from robot.simulation.trajectory import MotionHistory
from robot.simulation.world import World
from robot.simulation.worlds import make_world
from shared.errors import HardwareError
from shared.geometry import FloatArray, se3
from shared.head import turned

logger = logging.getLogger(__name__)

PHYSICS_SLEEP_S = 0.004
MAX_CATCH_UP_S = 5.0  # after a longer standstill of the process the lost samples are skipped, as a real FIFO would
TRUTH_LOG_RATE_HZ = 45.0
MAX_TRUTH_LOG = int(3600 * 4 * TRUTH_LOG_RATE_HZ)
IMU_LIMIT = 2250  # ten seconds for a reader that stalls
EXPOSURE_MARGIN_S = 0.025  # motion known beyond the last row before a picture is taken
CAMERA_RESTART_S = 1.0
AHEAD_RAD = math.radians(1.0)  # servos at rest are not quite still
BATTERY_FULL_V, BATTERY_EMPTY_V = 8.4, 6.4
BATTERY_LIFE_S, DRIVING_FACTOR = 4 * 3600.0, 3.0


class Closable(Protocol):
    def close(self) -> None: ...


def _looks_ahead(states: list[MotionState]) -> bool:
    """Whether the head is straight ahead: a depth sensor is told to be fixed to the body."""
    return all(max(map(abs, state.head)) < AHEAD_RAD for state in states)


class SimulatedRobot:
    """World, body and sensors. Methods may be called from any thread; times are time.monotonic_ns()."""

    def __init__(self, world: str, seed: int, config: SimulationConfig, cache_dir: Path | None) -> None:
        self.world: World = make_world(world, seed, config)
        self.config = config
        self.calibration = simulated_calibration(config)
        assert self.calibration.imu is not None and self.calibration.camera is not None
        self._built_camera = built_camera(self.calibration.camera, config.build)
        self.space = FreeSpace(self.world, config.body.radius_m)
        start = plan_route(self.world, "mapping", 0, config.body.radius_m) if world != "checker" else None
        pose = (
            (float(start.points[0, 0]), float(start.points[0, 1]), start.start_yaw_rad) if start else self.world.start
        )
        self._body = Body(self.world, config.body, pose, seed)
        self._imu = ImuModel(self.calibration.imu, config.imu, self.calibration.gravity, seed)
        self._history = MotionHistory(keep_s=3.0)
        self._dropout = np.random.default_rng([seed, 15])
        self._job = (world, seed, config, cache_dir)
        self.imu_mailbox: Mailbox[ImuReading] = Mailbox(IMU_LIMIT)
        self.frame_mailbox: Mailbox[CapturedFrame] = Mailbox(1)
        self.depth_mailbox: Mailbox[CapturedDepth] = Mailbox(1)
        self.camera_pid: int | None = None  # of the process that renders
        self.faults: Faults = config.faults  # from the next sample and frame on
        self._servos = Servos(config.servos, seed)
        self._hung: HungBoard | None = None
        self._truth_log = TruthLog(MAX_TRUTH_LOG)
        self._state = self._body.state()
        self._drive_until_ns = 0
        self._lock = threading.RLock()
        self._stopped = threading.Event()
        self._epoch_ns = time.monotonic_ns()
        self._skipped_ticks = 0
        self._drained = 0.0
        self._control: Closable | None = None
        self._threads: list[threading.Thread] = []

    def start(self, control: Closable | None = None) -> None:
        self._control = control
        self._epoch_ns = time.monotonic_ns()
        self._threads = [
            threading.Thread(target=self._live, name="simulated-physics", daemon=True),
            threading.Thread(target=self._take_pictures, name="simulated-camera", daemon=True),
        ]
        for thread in self._threads:
            thread.start()

    def close(self) -> None:
        """Stop everything; safe to call twice."""
        if self._stopped.is_set():
            return
        self._stopped.set()
        if self._control is not None:
            self._control.close()
        for thread in self._threads:
            thread.join(timeout=5.0)

    # --- what the devices need ------------------------------------------------------------------------------------

    def command(self, linear_m_s: float, angular_rad_s: float, until_ns: int) -> None:
        """Hold a velocity until a monotonic time; what comes later changes nothing."""
        with self._lock:
            if time.monotonic_ns() < until_ns:  # the body's clock may be behind ours
                self._body.command(linear_m_s, angular_rad_s)
                self._drive_until_ns = until_ns

    def halt(self) -> None:
        """Motors off now."""
        with self._lock:
            self._body.command(0.0, 0.0)

    def point_head(self, pan_rad: float, tilt_rad: float) -> None:
        """What the servos that carry the camera are told."""
        with self._lock:
            self._servos.point(pan_rad, tilt_rad)

    def battery(self) -> BatteryState:
        fraction = max(0.0, 1.0 - self._drained)
        return BatteryState(BATTERY_EMPTY_V + fraction * (BATTERY_FULL_V - BATTERY_EMPTY_V), fraction)

    def hijack(self, x_m: float, y_m: float, yaw_rad: float) -> float:
        """Pick the robot up and put it down elsewhere; returns how long that takes (s). Raises ValueError."""
        if not all(map(math.isfinite, (x_m, y_m, yaw_rad))):
            raise ValueError("the position is not finite")
        clearance = float(self.space.boxes.clearance(np.array([[x_m, y_m]]))[0])
        x0, y0, x1, y1 = self.world.bounds()
        if not (x0 <= x_m <= x1 and y0 <= y_m <= y1) or clearance < self.config.body.radius_m:
            raise ValueError(f"({x_m:.2f}, {y_m:.2f}) m is not free floor of this world")
        with self._lock:
            return self._body.hijack(x_m, y_m, yaw_rad)

    def hang_board(self, board: Board, T_cam_board: FloatArray) -> None:
        """Hang a board into the world, seen from where the camera is now; it stays when the robot moves."""
        with self._lock:
            self._hung = HungBoard(board, self._T_world_cam() @ T_cam_board)

    def take_board_away(self) -> None:
        self._hung = None

    def wave(self, board: Board, distance_m: float, duration_s: float, seed: int) -> None:
        """Hang a board ahead of the camera and wave the robot before it. Raises ValueError: it is moving."""
        rng = np.random.default_rng([seed, 31])
        with self._lock:
            rig = WavedRig(Wave(), distance_m, self._T_body_cam(), rng, self._T_world_cam(), duration_s)
            self._body.wave(rig, duration_s)
            self.hang_board(board, board_ahead(board, distance_m))

    def _T_world_cam(self) -> FloatArray:
        state = self._state
        return se3(state.R_world_body, state.p_world) @ self._T_body_cam()

    def _T_body_cam(self) -> FloatArray:
        """As the head is turned now."""
        head, mounted = self.calibration.head, self._built_camera.T_body_cam_matrix
        return mounted if head is None else turned(head, *self._state.head) @ mounted

    # --- what tests and judges may know ---------------------------------------------------------------------------

    @property
    def is_carried(self) -> bool:
        return self._body.is_carried

    def truth(self) -> tuple[int, MotionState]:
        """Robot time and true motion now."""
        with self._lock:
            return self._ns(self._state.t_s), self._state

    def truth_log(self) -> list[tuple[int, FloatArray]]:
        """All times and T_world_body so far, at TRUTH_LOG_RATE_HZ."""
        with self._lock:
            return self._truth_log.read()

    def plan(self, kind: str, seed: int) -> Route:
        """A route from where the robot is."""
        with self._lock:
            x, y, _ = self._body.pose
        return plan_route(self.world, kind, seed, self.config.body.radius_m, start=(x, y))

    def spot_in_another_room(self, seed: int) -> tuple[float, float, float]:
        """As `FreeSpace.random_spot`, of a room that the robot is not in; of the same one where there is no other."""
        p = self.truth()[1].p_world
        here = self.world.room_at(float(p[0]), float(p[1]))
        others = [room.name for room in self.world.rooms if room.name != here]
        return self.space.random_spot(seed, others[seed % len(others)] if others else None)

    # --- threads --------------------------------------------------------------------------------------------------

    def _ns(self, t_s: float) -> int:
        """Robot time of an instant of the body's clock; both run together but for skipped ticks."""
        return self._epoch_ns + round((t_s + self._skipped_ticks * TICK_S) * 1e9)

    def _live(self) -> None:
        ticks = 0
        while not self._stopped.wait(PHYSICS_SLEEP_S):
            due = int((time.monotonic_ns() - self._epoch_ns) * 1e-9 * TICK_RATE_HZ) - self._skipped_ticks
            if due - ticks > MAX_CATCH_UP_S * TICK_RATE_HZ:
                logger.warning("the simulator stood still for %.1f s; its samples are lost", (due - ticks) * TICK_S)
                self._skipped_ticks += due - ticks - 1
                due = ticks + 1
            while ticks < due:
                ticks += 1
                self._tick(ticks)

    def _tick(self, ticks: int) -> None:
        with self._lock:
            if self._ns(self._state.t_s) >= self._drive_until_ns:
                self._body.command(0.0, 0.0)
            self._state = state = replace(self._body.step(), head=self._servos.step())
            self._history.append(state)
            t_ns = self._ns(state.t_s)
            if ticks % round(TICK_RATE_HZ / TRUTH_LOG_RATE_HZ) == 0:
                self._truth_log.append(t_ns, self._history.pose(state.t_s))
        measurement = self._imu.measure(state)
        is_moving = bool(np.hypot(*state.v_world[:2]) > 0.02)
        self._drained += TICK_S / BATTERY_LIFE_S * (DRIVING_FACTOR if is_moving else 1.0)
        if self.faults.imu_dropout > 0 and self._dropout.random() < self.faults.imu_dropout:
            return
        (wx, wy, wz), (ax, ay, az) = measurement.gyro_imu.tolist(), measurement.accel_imu.tolist()
        self.imu_mailbox.put(ImuReading(ticks + self._skipped_ticks, t_ns, (wx, wy, wz), (ax, ay, az)))

    def _take_pictures(self) -> None:
        while not self._stopped.is_set():
            process = CameraProcess(*self._job)
            self.camera_pid = process.pid
            try:
                process.wait_until_ready()
                self.frame_mailbox.recover()
                self._take_pictures_with(process)
            except HardwareError as exc:
                logger.error("%s", exc)
                self.frame_mailbox.fail(exc)
                self._stopped.wait(CAMERA_RESTART_S)
            finally:
                process.close()

    def _take_pictures_with(self, process: CameraProcess) -> None:
        camera = self._built_camera
        period_s = 1.0 / self.config.camera_rate_hz
        readout_s = camera.line_delay_s * camera.height
        number = 0
        depth_hz, depth_due_s = self.config.depth.rate_hz, 0.0
        while not self._stopped.is_set():
            with self._lock:
                latest = self._history.end_s
            newest = int((latest - readout_s - EXPOSURE_MARGIN_S) / period_s) if math.isfinite(latest) else 0
            if newest <= number:
                self._stopped.wait(0.004)
                continue
            number = newest
            if self.faults.frozen_camera:
                continue
            t_s = number * period_s
            with self._lock:
                states = self._history.between(t_s - EXPOSURE_MARGIN_S, t_s + readout_s + EXPOSURE_MARGIN_S)
                with_depth = depth_hz > 0 and t_s >= depth_due_s and _looks_ahead(states)
                request = FrameRequest(t_s, states, self.faults, self._history.carried(t_s), self._hung, with_depth)
                t_ns = self._ns(t_s)
            jpeg, exposure_s, depth_png = process.take(request)
            if depth_png:
                depth_due_s = t_s + 1.0 / depth_hz
                # The picture's middle row; the sensor is fixed to the body, whose clock is the IMU's.
                self.depth_mailbox.put(CapturedDepth(t_ns + round(0.5e9 * readout_s), depth_png))
            t_ns -= round(camera.time_shift_s * 1e9)
            self.frame_mailbox.put(CapturedFrame(t_ns, round(exposure_s * 1e9), camera.width, camera.height, jpeg))
