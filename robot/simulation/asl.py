"""Writes EuRoC/ASL dataset folders: images, IMU, truth, drive commands. Nothing half-written stays under the name."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType

import msgspec
import numpy as np

from robot.simulation.body import MotionState
from robot.simulation.sensors import ImuMeasurement
from shared.calibration import Calibration, HeadCalibration
from shared.calibration_yaml import camera_sensor_text, imu_sensor_text
from shared.errors import DataError
from shared.geometry import FloatArray, IntArray, quat_from_rotation

START_NS = 1_000_000_000_000  # robot clock at the first sample; all stamps of a drive have equally many digits
TRUTH = "state_groundtruth_estimate0"
_COLUMNS = {
    "cam0": "#timestamp [ns],filename,exposure [ns]",
    "imu0": "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],"
    "a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]",
    TRUTH: "#timestamp,p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z [],"
    "v_RS_R_x [m s^-1],v_RS_R_y [m s^-1],v_RS_R_z [m s^-1],b_w_RS_S_x [rad s^-1],b_w_RS_S_y [rad s^-1],"
    "b_w_RS_S_z [rad s^-1],b_a_RS_S_x [m s^-2],b_a_RS_S_y [m s^-2],b_a_RS_S_z [m s^-2]",
    "drive0": "#timestamp [ns],linear [m s^-1],angular [rad s^-1],pan [rad],tilt [rad]",
}


class AslWriter:
    """Collects one recording into DIR; the folder appears under its name when it is complete.

    A sensor that the calibration does not have gets no folder.
    """

    def __init__(self, out: Path, calibration: Calibration) -> None:
        self._out = out
        self._partial = out.with_name(out.name + ".partial")
        mav = self._partial / "mav0"
        absent = {name for name, sensor in (("cam0", calibration.camera), ("imu0", calibration.imu)) if sensor is None}
        tables = {name: columns for name, columns in _COLUMNS.items() if name not in absent}
        try:
            if out.exists() and any(out.iterdir() if out.is_dir() else [out]):
                raise DataError(f"{out} already exists and is not empty; choose another --out or remove it")
            shutil.rmtree(self._partial, ignore_errors=True)
            for folder in tables:
                (mav / folder).mkdir(parents=True, exist_ok=True)
            if calibration.camera:
                (mav / "cam0/data").mkdir()
        except OSError as exc:
            raise DataError(f"{out} cannot be written: {exc.strerror}; choose another --out") from exc
        if calibration.camera:
            (mav / "cam0/sensor.yaml").write_text(camera_sensor_text(calibration.camera, rig=calibration.rig))
        if calibration.imu:
            (mav / "imu0/sensor.yaml").write_text(imu_sensor_text(calibration.imu))
        self._files = {name: (mav / name / "data.csv").open("w") for name in tables}
        if calibration.head and "drive0" in tables:
            (mav / "drive0/head.yaml").write_text(head_yaml(calibration.head))
        for name, columns in tables.items():
            self._files[name].write(f"{columns}\n")
        self.num_frames = self.num_imu = 0

    def __enter__(self) -> AslWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for file in self._files.values():
            file.close()
        if kind is not None:
            shutil.rmtree(self._partial, ignore_errors=True)
            return
        if self._out.exists():
            self._out.rmdir()
        self._partial.rename(self._out)

    def add_file(self, name: str, text: str) -> None:
        """A further file beside mav0, such as the configuration of the run."""
        (self._partial / name).write_text(text)

    def add_frame(self, t_ns: int, jpeg: bytes, exposure_s: float) -> None:
        name = f"{t_ns}.jpg"
        (self._partial / "mav0/cam0/data" / name).write_bytes(jpeg)
        self._files["cam0"].write(f"{t_ns},{name},{round(exposure_s * 1e9)}\n")
        self.num_frames += 1

    def add_imu(self, t_ns: int, measurement: ImuMeasurement) -> None:
        values = ",".join(f"{v:.9g}" for v in (*measurement.gyro_imu, *measurement.accel_imu))
        self._files["imu0"].write(f"{t_ns},{values}\n")
        self.num_imu += 1

    def add_imu_block(self, t_ns: IntArray, readings: FloatArray) -> None:
        """Many samples at once: times (N,), gyro and accelerometer (N, 6) rad/s, m/s^2."""
        line = "%d,%.9g,%.9g,%.9g,%.9g,%.9g,%.9g\n"
        cells = (cell for t, row in zip(t_ns.tolist(), readings.tolist(), strict=True) for cell in (t, *row))
        self._files["imu0"].write(line * len(t_ns) % tuple(cells))
        self.num_imu += len(t_ns)

    def add_truth(self, t_ns: int, motion: MotionState, biases: Sequence[FloatArray]) -> None:
        q = quat_from_rotation(motion.R_world_body)
        numbers = np.concatenate([motion.p_world, q, motion.v_world, *biases])
        self._files[TRUTH].write(f"{t_ns}," + ",".join(f"{v:.9g}" for v in numbers) + "\n")

    def add_drive(self, t_ns: int, linear_m_s: float, angular_rad_s: float, head: tuple[float, float]) -> None:
        """What motors and head (pan, tilt in rad) were told."""
        values = ",".join(f"{v:.6g}" for v in (linear_m_s, angular_rad_s, *head))
        self._files["drive0"].write(f"{t_ns},{values}\n")


def head_yaml(head: HeadCalibration) -> str:
    """The pan-tilt head that carries the camera; the keys are those of shared.calibration.HeadCalibration."""
    values = {**msgspec.structs.asdict(head), "pivot_body": list(head.pivot_body)}
    return "".join(f"{key}: {value}\n" for key, value in values.items())
