"""kalibr's camera chain: the calibration of a camera and its IMU, as kalibr's users and tools have it."""

from __future__ import annotations

import yaml

from shared.calibration import CameraCalibration


def camchain_text(camera: CameraCalibration, topic: str = "/cam0/image_raw") -> str:
    """`camchain-imucam.yaml` of one camera. `T_cam_imu` maps IMU to camera coordinates; the time shift is ours.

    Source: the kalibr wiki, "YAML formats".
    """
    cam0 = {
        "cam_overlaps": [],
        "camera_model": "pinhole",
        "distortion_coeffs": list(map(float, camera.distortion)),
        "distortion_model": "equidistant" if camera.model == "equidistant" else "radtan",
        "intrinsics": [float(v) for v in (camera.fx, camera.fy, camera.cx, camera.cy)],
        "line_delay": float(camera.line_delay_s),
        "resolution": [camera.width, camera.height],
        "rostopic": topic,
        "timeshift_cam_imu": float(camera.time_shift_s),
        "T_cam_imu": camera.T_cam_body_matrix.tolist(),
    }
    return yaml.safe_dump({"cam0": cam0}, sort_keys=False, default_flow_style=None, width=200)
