"""Each imperfection of the camera does what it says and can be switched off."""

import cv2
import msgspec
import numpy as np
import pytest

from robot.simulation.config import (
    CameraImperfections,
    Faults,
    load_config,
    without_imperfections,
)
from robot.simulation.imaging import Exposure, SimulatedCamera
from robot.simulation.renderer import Renderer
from robot.simulation.worlds import make_world
from shared.calibration import REFERENCE_CAMERA
from shared.errors import ConfigError
from shared.geometry import FloatArray, se3, yaw_rotation

IDEAL = without_imperfections().camera
TURN_RATE = 0.5  # rad/s


@pytest.fixture(scope="module")
def renderer() -> Renderer:
    return Renderer(make_world("checker", 0), REFERENCE_CAMERA)


def still(_t_s: float) -> FloatArray:
    return se3(yaw_rotation(0.1), np.array([1.9, 1.2, 1.1]))


def turning(t_s: float) -> FloatArray:
    return se3(yaw_rotation(0.1 + TURN_RATE * t_s), np.array([1.9, 1.2, 1.1]))


def rolling(t_s: float) -> FloatArray:
    c, s = np.cos(2.0 * t_s), np.sin(2.0 * t_s)
    return se3(np.array([[1.0, 0, 0], [0, c, -s], [0, s, c]]), np.array([1.9, 1.2, 1.1]))


def take(renderer: Renderer, imperfections: CameraImperfections, pose=still, faults: Faults | None = None) -> Exposure:  # type: ignore[no-untyped-def]
    return SimulatedCamera(renderer, REFERENCE_CAMERA, imperfections, 0).expose(pose, 0.0, faults or Faults())


def sharpness(image: np.ndarray, axis: int) -> float:
    return float((np.diff(image[:, :, 1].astype(float), axis=axis) ** 2).mean())


def test_with_everything_off_the_picture_is_the_rendering(renderer: Renderer) -> None:
    picture = take(renderer, IDEAL).image
    T = still(0.0) @ REFERENCE_CAMERA.T_body_cam_matrix
    assert (picture == renderer.render(T[None]).image).all()


@pytest.mark.parametrize(
    "change",
    [{"noise": 2.0}, {"vignetting": 0.3}, {"lens_blur_px": 0.6}],
    ids=["noise", "vignetting", "lens blur"],
)
def test_each_still_imperfection_changes_the_picture(renderer: Renderer, change: dict[str, float]) -> None:
    ideal, changed = take(renderer, IDEAL).image, take(renderer, msgspec.structs.replace(IDEAL, **change)).image
    assert np.abs(ideal.astype(int) - changed).mean() > 0.3


def test_motion_blur_smears_along_the_motion_only(renderer: Renderer) -> None:
    sharp = take(renderer, IDEAL, turning).image
    blurred = take(renderer, msgspec.structs.replace(IDEAL, motion_blur=True, exposure_ms=12.0), turning).image
    assert sharpness(blurred, axis=1) < 0.5 * sharpness(sharp, axis=1)
    assert sharpness(blurred, axis=0) > 0.8 * sharpness(sharp, axis=0)
    assert (take(renderer, msgspec.structs.replace(IDEAL, motion_blur=True)).image == take(renderer, IDEAL).image).all()


def test_motion_blur_of_a_rotation_about_the_axis_leaves_the_middle_sharp(renderer: Renderer) -> None:
    sharp = take(renderer, IDEAL, rolling).image
    blurred = take(renderer, msgspec.structs.replace(IDEAL, motion_blur=True, exposure_ms=12.0), rolling).image
    middle, corner = np.s_[217:297, 295:375], np.s_[:80, :80]
    change = np.abs(sharp.astype(int) - blurred).mean(-1)
    assert change[corner].mean() > 1.5 * change[middle].mean()


def test_rolling_shutter_slants_upright_edges(renderer: Renderer) -> None:
    with_shutter = take(renderer, msgspec.structs.replace(IDEAL, rolling_shutter=True), turning).image.astype(int)
    without = take(renderer, IDEAL, turning).image.astype(int)
    difference = np.abs(with_shutter - without).mean((1, 2))
    assert difference[:5].mean() < 1.0  # the first row is exposed at the stamp
    assert difference[-50:].mean() > 10.0


def test_auto_exposure_brings_a_dark_room_back_to_middle_grey_and_adds_noise(renderer: Renderer) -> None:
    imperfections = msgspec.structs.replace(IDEAL, auto_exposure=True, noise=1.0)
    camera = SimulatedCamera(renderer, REFERENCE_CAMERA, imperfections, 0)
    dark = Faults(light=0.3)
    first = camera.expose(still, 0.0, dark)
    for k in range(40):
        last = camera.expose(still, 0.05 * k, dark)
    assert last.image.mean() > 2 * first.image.mean()
    assert last.exposure_s > first.exposure_s
    fixed = SimulatedCamera(renderer, REFERENCE_CAMERA, IDEAL, 0)
    assert len({fixed.expose(still, 0.05 * k, dark).exposure_s for k in range(5)}) == 1


def test_covered_lens_is_dark_and_without_corners(renderer: Renderer) -> None:
    covered = take(renderer, IDEAL, faults=Faults(covered_lens=True)).image
    assert covered.mean() < 40
    assert cv2.Laplacian(covered, cv2.CV_32F).std() < 2.0


def test_a_person_walks_through_the_picture(renderer: Renderer) -> None:
    camera = SimulatedCamera(renderer, REFERENCE_CAMERA, IDEAL, 0)
    empty = camera.expose(still, 0.0, Faults()).image.astype(int)
    shares = [np.mean(camera.expose(still, t, Faults(person=True)).image != empty) for t in np.linspace(0, 4, 15)]
    assert max(shares) > 0.05 and min(shares) < 0.5 * max(shares)


def test_lower_jpeg_quality_makes_smaller_files(renderer: Renderer) -> None:
    sizes = [len(take(renderer, msgspec.structs.replace(IDEAL, jpeg_quality=q)).jpeg) for q in (40, 95)]
    assert sizes[0] < 0.6 * sizes[1]


def test_same_seed_same_noise(renderer: Renderer) -> None:
    jpegs = [take(renderer, CameraImperfections()).jpeg for _ in range(2)]
    assert jpegs[0] == jpegs[1]


def test_configuration_refuses_unknown_keys_and_wrong_types(tmp_path) -> None:  # type: ignore[no-untyped-def]
    file = tmp_path / "sim.toml"
    file.write_text("camera_rate_hz = 15\n[camera]\nnoise = 0\nmotion_blur = false\n")
    config = load_config(file)
    assert config.camera_rate_hz == 15.0 and config.camera.noise == 0.0 and not config.camera.motion_blur
    unknown, mistyped = (
        ("colour = 1", r"sim\.toml: .*`colour` - at `camera`"),
        ("motion_blur = 1", r"`camera\.motion_blur`"),
    )
    for wrong, named in (unknown, mistyped):
        file.write_text(f"[camera]\n{wrong}\n")
        with pytest.raises(ConfigError, match=named):
            load_config(file)
    with pytest.raises(ConfigError, match=r"sim\.toml|absent"):
        load_config(tmp_path / "absent.toml")
