"""Renders a world along a recorded path, so that a real IMU gets images that belong to it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from robot.simulation.asl import AslWriter
from robot.simulation.body import MotionState
from robot.simulation.config import SimulationConfig
from robot.simulation.construction import built_camera
from robot.simulation.imaging import SimulatedCamera
from robot.simulation.renderer import Renderer
from robot.simulation.sensors import ImuMeasurement, ImuModel
from robot.simulation.trajectory import MotionHistory
from robot.simulation.world import World
from shared.calibration import Calibration, CameraCalibration, ImuNoise
from shared.errors import DataError
from shared.geometry import FloatArray, IntArray, rotation_from_quat, so3_log
from shared.recorded_files import asl_numbers, asl_rows
from shared.sensor_yaml import read_camera, read_imu_noise, read_yaml

NUM_STATE_COLUMNS = 17


@dataclass(frozen=True, slots=True, eq=False)
class StateTable:
    """Rows of a state_groundtruth_estimate0 file: stamps and p, q wxyz, v, gyro bias, accel bias."""

    t_ns: IntArray  # (N,)
    values: FloatArray  # (N, 16)

    def path(self) -> MotionHistory:
        """The states as a function of seconds since the first one."""
        t_s = (self.t_ns - self.t_ns[0]) * 1e-9
        R = rotation_from_quat(self.values[:, 3:7])
        v = self.values[:, 7:10]
        a, omega = np.gradient(v, t_s, axis=0), np.zeros_like(v)
        for i in range(len(R)):
            low, high = max(i - 1, 0), min(i + 1, len(R) - 1)
            omega[i] = so3_log(R[low].T @ R[high]) / (t_s[high] - t_s[low])
        return MotionHistory(
            [MotionState(float(t_s[i]), self.values[i, :3], R[i], v[i], a[i], omega[i]) for i in range(len(R))]
        )


def read_states(path: Path) -> StateTable:
    """Read a states CSV (ASL). Raises DataError that names file and line."""
    stamps, rows = [], []
    for number, t_ns, cells in asl_rows(path, 10):
        try:
            values = [float(cell) for cell in cells[: NUM_STATE_COLUMNS - 1]]
        except ValueError as exc:
            raise DataError(f"{path} line {number} does not hold numbers; correct or remove it") from exc
        stamps.append(t_ns)
        rows.append(values + [0.0] * (NUM_STATE_COLUMNS - 1 - len(values)))
    if len(rows) < 2 or not np.isfinite(rows).all():
        raise DataError(f"{path} needs at least two finite states")
    return StateTable(np.array(stamps), np.array(rows))


DEFAULT_IMU = ImuNoise(gyro_density=1.7e-4, accel_density=2e-3, gyro_walk=1.9e-5, accel_walk=3e-3, rate_hz=200.0)


def render_along(
    world: World,
    states: Path,
    camera_file: Path,
    imu_folder: Path | None,
    out: Path,
    config: SimulationConfig,
    seed: int,
    start_s: float = 0.0,
    duration_s: float = np.inf,
    cache_dir: Path | None = None,
    on_progress: Callable[[float], None] | None = None,
) -> int:
    """Write an ASL folder with images along the path; returns the number of frames.

    Args:
        states: CSV of true states.
        camera_file: sensor.yaml; a data.csv beside it gives the stamps.
        imu_folder: folder with data.csv and sensor.yaml to copy; None: synthesise.
        start_s: after the first state.
    """
    cv2.setNumThreads(1)
    table = read_states(states)
    lens = read_camera(camera_file)
    built = built_camera(lens, config.build)
    noise = DEFAULT_IMU
    if imu_folder:
        noise = read_imu_noise(imu_folder / "sensor.yaml", read_yaml(imu_folder / "sensor.yaml"))
    calibration = Calibration(camera=lens, imu=noise)
    path = table.path()
    first = int(table.t_ns[0])
    begin_s = max(start_s, path.start_s)
    end_s = min(begin_s + duration_s, path.end_s)
    stamps = _frame_stamps(camera_file.parent / "data.csv", lens, first, begin_s, end_s)
    last_s = end_s - lens.line_delay_s * lens.height - 0.01  # every exposed row needs a pose
    stamps = [s for s in stamps if begin_s <= (s - first) * 1e-9 + built.time_shift_s <= last_s]
    if not stamps:
        raise DataError(f"no frame stamp lies between {begin_s:.2f} s and {end_s:.2f} s of {states}")
    camera = SimulatedCamera(Renderer(world, built, cache_dir), built, config.camera, seed)
    with AslWriter(out, calibration) as writer:
        for k, stamp in enumerate(stamps):
            exposure = camera.expose(path.pose, (stamp - first) * 1e-9 + built.time_shift_s, config.faults)
            writer.add_frame(stamp, exposure.jpeg, exposure.exposure_s)
            if on_progress:
                on_progress((k + 1) / len(stamps))
        low, high = first + round(begin_s * 1e9), first + round(end_s * 1e9)
        imu = None if imu_folder else ImuModel(noise, config.imu, calibration.gravity, seed)
        for t_ns, row, state in zip(table.t_ns.tolist(), table.values, path.states, strict=True):
            if low <= t_ns <= high:
                writer.add_truth(t_ns, state, (row[10:13], row[13:16]))
                if imu is not None:
                    writer.add_imu(t_ns, imu.measure(state))
        if imu_folder:
            for t_ns, numbers in asl_numbers(imu_folder / "data.csv", 6):
                if low <= t_ns <= high:
                    gyro, accel = np.array(numbers[:3]), np.array(numbers[3:])
                    writer.add_imu(t_ns, ImuMeasurement(gyro, accel, np.zeros(3), np.zeros(3)))
    return len(stamps)


def _frame_stamps(data_csv: Path, camera: CameraCalibration, first_ns: int, begin_s: float, end_s: float) -> list[int]:
    """Recorded stamps where there are any, else evenly spaced ones."""
    if data_csv.is_file():
        return [t_ns for _, t_ns, _ in asl_rows(data_csv, 0)]
    count = int((end_s - begin_s) * camera.rate_hz)
    return [first_ns + round((begin_s + k / camera.rate_hz) * 1e9) for k in range(count)]
