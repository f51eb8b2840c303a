"""The camera as it is best known: the told one, corrected by the drive."""

from __future__ import annotations

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from shared.calibration import REFERENCE_CAMERA, CameraCalibration
from shared.geometry import so3_log
from station.model.best_camera import (
    TOLD_FOCAL_SIGMA,
    TOLD_MOUNTING_SIGMA_DEG,
    best_camera,
    corrected,
    misfit_of,
    unless_it_fits,
)
from station.model.calibration_fit import CalibrationFit, judge
from station.model.navigation import Navigation
from tests.support.places import make_map


def focal_fit(scale: float, sigma: float) -> CalibrationFit:
    return judge((scale, sigma), np.zeros(3), np.full(3, 0.2), (0.0, 0.001))


def longer(camera: CameraCalibration, scale: float) -> CameraCalibration:
    return msgspec.structs.replace(camera, fx=scale * camera.fx, fy=scale * camera.fy)


def mapped(told: CameraCalibration, fit: CalibrationFit) -> Navigation:
    """By a robot that told this camera, of which its drive said that."""
    navigation = make_map().navigation
    calibration = msgspec.structs.replace(navigation.calibration, camera=corrected(told, fit).camera)
    report = replace(navigation.report, calibration_fit=fit, told_camera=told)
    return replace(navigation, calibration=calibration, report=report)


def test_without_a_fit_the_camera_is_as_told() -> None:
    known = corrected(REFERENCE_CAMERA, None)
    assert known.camera == REFERENCE_CAMERA and known.focal_sigma == TOLD_FOCAL_SIGMA


@pytest.mark.parametrize("scale", [0.95, 1.0, 1.03])
def test_a_fit_as_good_as_what_is_told_meets_it_half_way(scale: float) -> None:
    known = corrected(REFERENCE_CAMERA, focal_fit(scale, TOLD_FOCAL_SIGMA))
    assert known.camera.fx == pytest.approx(np.sqrt(scale) * REFERENCE_CAMERA.fx)
    assert known.camera.fx / known.camera.fy == pytest.approx(REFERENCE_CAMERA.fx / REFERENCE_CAMERA.fy)
    assert known.focal_sigma == pytest.approx(TOLD_FOCAL_SIGMA / np.sqrt(2.0))


def test_the_better_the_fit_the_more_it_corrects() -> None:
    moved = [corrected(REFERENCE_CAMERA, focal_fit(1.05, sigma)).camera.fx for sigma in (1.0, 0.02, 0.004, 1e-6)]
    assert moved == sorted(moved)
    assert moved[0] == pytest.approx(REFERENCE_CAMERA.fx, rel=1e-4)
    assert moved[-1] == pytest.approx(1.05 * REFERENCE_CAMERA.fx, rel=1e-4)


@pytest.mark.parametrize("axis", range(3))
def test_a_turned_camera_is_turned_back_by_as_much_as_is_known(axis: int) -> None:
    turned, sigma = np.eye(3)[axis] * 2.0, np.full(3, 10.0)
    sigma[axis] = TOLD_MOUNTING_SIGMA_DEG
    camera = corrected(REFERENCE_CAMERA, judge((1.0, 0.01), turned, sigma, (0.0, 0.001))).camera
    R_told_now = REFERENCE_CAMERA.T_body_cam_matrix[:3, :3].T @ camera.T_body_cam_matrix[:3, :3]
    assert np.degrees(so3_log(R_told_now)) == pytest.approx(turned / 2.0)
    assert camera.T_body_cam_matrix[:3, 3] == pytest.approx(REFERENCE_CAMERA.T_body_cam_matrix[:3, 3])


@pytest.mark.parametrize(("sigmas", "is_corrected"), [(0.0, False), (-2.9, False), (3.3, True), (-7.0, True)])
def test_what_the_drive_cannot_tell_from_the_told_camera_corrects_nothing(sigmas: float, is_corrected: bool) -> None:
    focal = focal_fit(np.exp(0.003 * sigmas), 0.003)
    turned = judge((1.0, 0.003), np.array([0.0, 0.2 * sigmas, 0.0]), np.full(3, 0.2), (0.0, 0.001))
    for fit in (focal, turned):
        chosen = corrected(REFERENCE_CAMERA, fit).camera if is_corrected else REFERENCE_CAMERA
        assert unless_it_fits(REFERENCE_CAMERA, fit) == chosen
    assert unless_it_fits(REFERENCE_CAMERA, None) == REFERENCE_CAMERA


def test_images_of_a_robot_that_tells_the_same_are_looked_for_with_the_camera_of_the_map() -> None:
    navigation = mapped(REFERENCE_CAMERA, focal_fit(1.03, 0.003))
    assert best_camera(REFERENCE_CAMERA, navigation) == navigation.calibration.camera
    unsure = focal_fit(0.98, 0.02)  # a drive that has just begun
    assert best_camera(REFERENCE_CAMERA, navigation, unsure) == navigation.calibration.camera


def test_a_drive_that_knows_the_camera_better_than_the_mapping_drive_is_believed() -> None:
    navigation, own = mapped(REFERENCE_CAMERA, focal_fit(1.03, 0.006)), focal_fit(1.02, 0.002)
    assert best_camera(REFERENCE_CAMERA, navigation, own) == corrected(REFERENCE_CAMERA, own).camera


def test_another_camera_is_corrected_by_its_own_drive_only() -> None:
    navigation, other = mapped(REFERENCE_CAMERA, focal_fit(1.03, 0.003)), longer(REFERENCE_CAMERA, 0.8)
    own = focal_fit(0.97, 0.02)
    assert best_camera(other, navigation) == other
    assert best_camera(other, navigation, own) == corrected(other, own).camera


def test_in_a_map_that_was_not_corrected_the_told_camera_is_used() -> None:
    navigation = make_map().navigation
    told = navigation.calibration.camera
    assert told is not None
    assert best_camera(told, navigation, focal_fit(0.97, 0.003)) == told


def test_of_a_map_whose_calibration_seems_wrong_it_is_said_that_nobody_knows() -> None:
    report = mapped(REFERENCE_CAMERA, focal_fit(0.95, 0.01)).report
    assert "not known yet" in misfit_of(report) and "5.3% too long, give or take 1.0%" in misfit_of(report)
    assert misfit_of(mapped(REFERENCE_CAMERA, focal_fit(0.985, 0.02)).report) == ""


def test_a_message_says_that_the_map_is_corrected_only_where_it_is() -> None:
    report = mapped(REFERENCE_CAMERA, focal_fit(0.97, 0.003)).report
    assert "too long" in misfit_of(report) and "corrected" in misfit_of(report)
    assert "corrected" not in misfit_of(replace(report, told_camera=None))
    assert misfit_of(mapped(REFERENCE_CAMERA, focal_fit(0.995, 0.003)).report) == ""
