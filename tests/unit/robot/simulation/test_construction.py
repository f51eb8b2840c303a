"""A robot built with other numbers than it tells takes pictures by the ones and tells the others."""

from pathlib import Path

import cv2
import msgspec
import numpy as np
import pytest

from robot.app import open_devices
from robot.config import RobotConfig, SimulatedConfig
from robot.simulation.body import Body
from robot.simulation.config import BodyParameters, BuildErrors, SimulationConfig, load_config, without_imperfections
from robot.simulation.construction import built_camera
from robot.simulation.recording import record_drive, simulated_calibration
from robot.simulation.renderer import Renderer
from robot.simulation.routes import plan_route
from robot.simulation.worlds import make_world
from shared.calibration import REFERENCE_CAMERA
from shared.errors import ConfigError
from shared.geometry import so3_log
from shared.recorded_files import asl_rows
from shared.sensor_yaml import read_camera


def test_without_errors_the_camera_is_the_one_that_is_told() -> None:
    assert built_camera(REFERENCE_CAMERA, BuildErrors()) == REFERENCE_CAMERA


def test_a_seed_builds_another_camera_of_the_told_size() -> None:
    told = msgspec.structs.replace(REFERENCE_CAMERA, width=320, height=240)
    built, other = (built_camera(told, BuildErrors(seed=seed)) for seed in (1, 2))
    assert built != other
    assert (built.width, built.height, built.rate_hz) == (320, 240, told.rate_hz)
    assert 225 <= built.fx <= 450  # half of a camera's of 640 pixels
    assert abs(built.cx - 159.5) < 8
    turned = np.degrees(np.linalg.norm(so3_log(told.T_body_cam_matrix[:3, :3].T @ built.T_body_cam_matrix[:3, :3])))
    assert 0.5 < turned < 11
    shifted = built_camera(told, BuildErrors(seed=1, time_shift_ms=3, line_delay_us=5))
    assert shifted.time_shift_s == pytest.approx(built.time_shift_s + 3e-3)
    assert shifted.line_delay_s == pytest.approx(built.line_delay_s + 5e-6)


def test_each_error_changes_what_it_says() -> None:
    errors = BuildErrors(
        focal_percent=2, pitch_deg=1, yaw_deg=-1, roll_deg=2, forward_cm=1, left_cm=2, up_cm=-3, time_shift_ms=5
    )
    told, built = REFERENCE_CAMERA, built_camera(REFERENCE_CAMERA, errors)
    assert (built.fx, built.fy) == pytest.approx((1.02 * told.fx, 1.02 * told.fy))
    assert built.time_shift_s == pytest.approx(told.time_shift_s + 0.005)
    T_told, T_built = told.T_body_cam_matrix, built.T_body_cam_matrix
    np.testing.assert_allclose(T_built[:3, 3] - T_told[:3, 3], [0.01, 0.02, -0.03], atol=1e-12)
    turn = np.degrees(so3_log(T_told[:3, :3].T @ T_built[:3, :3]))
    np.testing.assert_allclose(turn, [1.0, -1.0, 2.0], atol=0.03)
    changed = {"fx", "fy", "T_body_cam", "time_shift_s"}
    for name in set(told.__struct_fields__) - changed:
        assert getattr(built, name) == getattr(told, name)


@pytest.mark.parametrize(("errors", "axis"), [(BuildErrors(pitch_deg=2), 2), (BuildErrors(yaw_deg=2), 1)])
def test_a_turned_mounting_looks_further_up_or_right(errors: BuildErrors, axis: int) -> None:
    optical = built_camera(REFERENCE_CAMERA, errors).T_body_cam_matrix[:3, 2]
    gain = optical[axis] - REFERENCE_CAMERA.T_body_cam_matrix[axis, 2]
    assert gain * (1 if axis == 2 else -1) == pytest.approx(np.sin(np.radians(2)), rel=0.1)  # y of the body is left


def test_the_picture_of_a_longer_lens_is_magnified() -> None:
    world = make_world("checker", 0)
    told, built = (built_camera(REFERENCE_CAMERA, BuildErrors(focal_percent=percent)) for percent in (0.0, 5.0))
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = REFERENCE_CAMERA.T_body_cam_matrix[:3, :3], (1.9, 2.0, 1.1)
    images = [cv2.cvtColor(Renderer(world, c).render(T[None]).image, cv2.COLOR_BGR2GRAY) for c in (told, built)]
    c = REFERENCE_CAMERA
    zoom = np.array([[1.05, 0.0, c.cx - 1.05 * c.cx], [0.0, 1.05, c.cy - 1.05 * c.cy]])
    magnified = cv2.warpAffine(images[0], zoom, (c.width, c.height))
    middle = np.s_[150:330, 220:420]  # the lens' distortion scales along with the picture only near its centre
    off = [float(np.abs(image[middle].astype(int) - images[1][middle]).mean()) for image in (magnified, images[0])]
    assert off[0] < 0.35 * off[1]


def test_a_recording_tells_the_told_calibration_and_stamps_by_the_built_one(tmp_path: Path) -> None:
    world = make_world("room", 1)
    route = plan_route(world, "triangle_a")
    config = without_imperfections()
    wrong = msgspec.structs.replace(config, build=BuildErrors(focal_percent=3, yaw_deg=1, time_shift_ms=5))
    stamps, images = [], []
    for name, settings in (("right", config), ("wrong", wrong)):
        record_drive(world, route, settings, 0, tmp_path / name, max_duration_s=0.6)
        camera = tmp_path / name / "mav0/cam0"
        told = simulated_calibration(config).camera
        assert told is not None
        assert read_camera(camera / "sensor.yaml").fx == pytest.approx(told.fx)
        stamps.append(np.array([t_ns for _, t_ns, _ in asl_rows(camera / "data.csv", 0)]))
        images.append(cv2.imread(str(min((camera / "data").glob("*.jpg")))))
    assert (stamps[0] - stamps[1] == 5_000_000).all()
    assert np.abs(images[0].astype(int) - images[1]).mean() > 2.0


async def test_robot_server_takes_build_errors_from_a_file_and_tells_the_same_calibration(tmp_path: Path) -> None:
    file = tmp_path / "simulation.toml"
    file.write_text("[build]\nfocal_percent = 3\ntime_shift_ms = 20\n[body]\nyaw_efficiency = 0.5\n")
    assert load_config(file).build == BuildErrors(focal_percent=3, time_shift_ms=20)
    devices = open_devices("simulated", RobotConfig(simulated=SimulatedConfig(world="checker", settings=str(file))))
    try:
        assert devices.calibration == simulated_calibration(SimulationConfig())
    finally:
        assert devices.camera is not None
        await devices.camera.close()
    file.write_text("[build]\nfocal = 3\n")
    with pytest.raises(ConfigError, match=r"simulation\.toml: .*`focal`"):
        open_devices("simulated", RobotConfig(simulated=SimulatedConfig(settings=str(file))))


def test_wheels_turn_as_they_were_built() -> None:
    def turned(yaw_efficiency: float) -> float:
        parameters = BodyParameters(yaw_efficiency=yaw_efficiency, yaw_efficiency_spread=0.0, wobble=False)
        body = Body(make_world("checker", 0), parameters, (2.0, 2.0, 0.0), 0)
        body.command(0.0, 0.5)
        for _ in range(450):
            state = body.step()
        return float(state.omega_body[2])

    assert turned(0.6) / turned(0.3) == pytest.approx(2.0, rel=0.05)  # slip follows the way rolled
