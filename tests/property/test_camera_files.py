"""Calibrations come back from the files that they are written to: ours and kalibr's."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shared.calibration import Calibration, CameraCalibration
from shared.calibration_yaml import calibration_text, read_calibration
from shared.geometry import se3
from station.calibration.camera_files import camchain_yaml, read_camchain

small = st.floats(-0.5, 0.5)


@st.composite
def cameras(draw: st.DrawFn) -> CameraCalibration:
    rotation = cv2.Rodrigues(np.array([draw(st.floats(-2.0, 2.0)) for _ in range(3)]))[0]
    T = se3(rotation, np.array([draw(small) for _ in range(3)]))
    width, height = draw(st.integers(1, 4000)), draw(st.integers(1, 4000))
    focal = max(width, height) * draw(st.floats(0.1, 40.0))
    return CameraCalibration(
        width=width,
        height=height,
        fx=focal,
        fy=focal * draw(st.floats(0.6, 1.2)),
        cx=draw(st.floats(-10.0, 4000.0)),
        cy=draw(st.floats(-10.0, 4000.0)),
        model=draw(st.sampled_from(["radtan", "equidistant"])),
        distortion=tuple(draw(small) for _ in range(4)),
        T_body_cam=tuple(T.ravel().tolist()),
        time_shift_s=draw(st.floats(-0.1, 0.1)),
        line_delay_s=draw(st.floats(0.0, 1e-4)),
    )


@given(camera=cameras())
def test_a_camera_comes_back_from_our_file_and_from_kalibrs(camera: CameraCalibration) -> None:
    with TemporaryDirectory() as folder:
        ours, kalibrs = Path(folder) / "calibration.yaml", Path(folder) / "camchain.yaml"
        ours.write_text(calibration_text(Calibration(camera=camera, imu=None)), encoding="utf-8")
        kalibrs.write_text(camchain_yaml(camera), encoding="utf-8")
        found = (read_calibration(ours).camera, read_camchain(kalibrs))
    for back in found:
        assert back is not None
        assert (back.width, back.height, back.model) == (camera.width, camera.height, camera.model)
        assert (back.fx, back.fy, back.cx, back.cy, *back.distortion) == (
            camera.fx, camera.fy, camera.cx, camera.cy, *camera.distortion,
        )  # fmt: skip
        assert (back.time_shift_s, back.line_delay_s) == (camera.time_shift_s, camera.line_delay_s)
        assert back.T_body_cam == pytest.approx(camera.T_body_cam, abs=1e-12)
