"""An accelerometer that was laid on its sides: what the rests tell of it, and when they do not."""

from __future__ import annotations

import dataclasses

import msgspec
import numpy as np
import pytest

from shared.calibration import REFERENCE_IMU, AccelerometerCalibration, upper_triangular
from shared.geometry import FloatArray
from station.calibration.imu.calibrate import calibrate_imu
from station.calibration.imu.report import calibration_json, calibration_lines
from station.calibration.imu.six_positions import (
    ANGLES,
    BIAS,
    SCALE,
    AccelerometerErrors,
    RestForces,
    fit_errors,
    missing_orientations,
    rest_forces,
)
from station.calibration.imu.still import find_stillness, on_even_grid
from station.motion.imu_buffer import ImuBuffer
from tests.support.inertial_noise import ACCEL, EDGES, FACES, TrueNoise, Turned, turned

pytestmark = pytest.mark.computing
TWELVE, NINE = np.vstack([FACES, EDGES]), np.vstack([FACES, EDGES[::2]])


def rests_of(unit: Turned) -> RestForces:
    samples = on_even_grid(unit.imu)
    return rest_forces(samples, find_stillness(samples).rests)


def errors_over_sigma(found: AccelerometerErrors, unit: Turned) -> FloatArray:
    """(9,) scale, angles, bias."""
    found_all = np.concatenate([found.scale, found.angles, found.bias])
    return (found_all - np.concatenate([unit.scale, unit.angles, unit.bias])) / found.sigma


@pytest.mark.parametrize("directions", [TWELVE, NINE, FACES], ids=["twelve", "nine", "six"])
def test_the_standard_deviations_are_honest_over_twenty_units(directions: FloatArray) -> None:
    units = [turned(seed, directions) for seed in range(20)]
    found = [fit_errors(rests_of(unit), ACCEL.density, ACCEL.walk, 9.81) for unit in units]
    z = np.array([errors_over_sigma(one, unit) for one, unit in zip(found, units, strict=True)])
    assert np.mean(np.abs(z) < 3.0) >= 0.97
    assert np.abs(z).max() < 4.0
    assert 0.3 < np.sqrt(np.mean(z**2)) < 1.3  # neither bold nor timid


def test_twelve_orientations_tell_all_nine_figures() -> None:
    for seed in range(5):
        unit = turned(seed, TWELVE)
        found = fit_errors(rests_of(unit), ACCEL.density, ACCEL.walk, 9.81)
        assert found.angles_known and found.num_rests == 12
        np.testing.assert_allclose(found.scale, unit.scale, atol=1e-3)
        np.testing.assert_allclose(found.angles, unit.angles, atol=3e-3)
        np.testing.assert_allclose(found.bias, unit.bias, atol=0.02)


def test_without_noise_the_truth_is_found_to_rounding() -> None:
    unit = turned(3, TWELVE, accel=TrueNoise(1e-9, 1e-9))
    found = fit_errors(rests_of(unit), 1e-6, 1e-9, 9.81)
    np.testing.assert_allclose(found.scale, unit.scale, atol=1e-7)
    np.testing.assert_allclose(found.angles, unit.angles, atol=1e-7)
    np.testing.assert_allclose(found.bias, unit.bias, atol=1e-6)


def test_a_sensor_that_is_not_linear_widens_the_standard_deviations() -> None:
    rests = rests_of(turned(1, TWELVE))
    bent = dataclasses.replace(rests, force=rests.force * (1.0 + 0.01 * (rests.force / 9.81) ** 2))
    plain, found = (fit_errors(r, ACCEL.density, ACCEL.walk, 9.81) for r in (rests, bent))
    assert found.rms > 5.0 * plain.rms
    assert (found.sigma > 2.0 * plain.sigma).all()


def around_one_axis(n: int) -> FloatArray:
    turn = np.linspace(0.0, 2.0 * np.pi, n, endpoint=False)
    return np.stack([np.cos(turn), np.sin(turn), 0.0 * turn], axis=1)


POOR = {
    "too few": (np.vstack([FACES[:4], FACES[:2]]), "it lay in 4 orientations"),
    "about one axis": (around_one_axis(9), "near one plane"),
    "about an oblique axis": (
        around_one_axis(9) @ np.linalg.qr(np.array([[1, 1, 1], [1, -1, 0], [0, 1, 0.5]]))[0],
        "near one plane",
    ),
    "never on its head": (np.vstack([FACES[:5], EDGES[:5]]), "z axis never pointed down"),
}


@pytest.mark.parametrize("mistake", POOR)
def test_orientations_that_cannot_tell_give_no_figures_but_the_remedy(mistake: str) -> None:
    directions, remedy = POOR[mistake]
    for seed in range(5):
        found = calibrate_imu(turned(seed, directions, rate_hz=50.0).imu)
        assert found.accelerometer is None and calibration_json(found)["accelerometer"] is None
        assert any(remedy in note for note in found.notes), found.notes
        assert found.accepted and found.used is not None  # the noise is known all the same


def test_good_orientations_lack_nothing() -> None:
    for directions in (FACES, NINE, TWELVE):
        for seed in range(20):
            assert list(missing_orientations(rests_of(turned(seed, directions, first_s=5.0)))) == []


def test_one_long_rest_says_nothing_of_other_sides() -> None:
    found = calibrate_imu(turned(0, FACES[2:3]).imu)
    assert found.accelerometer is None and not any("orientation" in note for note in found.notes)


def test_what_is_printed_and_written_of_twelve_orientations() -> None:
    unit = turned(2, TWELVE)
    found = calibrate_imu(unit.imu)
    report = calibration_json(found)["accelerometer"]
    assert found.accepted and found.accelerometer is not None
    assert (np.abs(errors_over_sigma(found.accelerometer, unit)) < 3.0).all()
    assert report["scale"] == found.accelerometer.scale.tolist() and len(report["misalignment"]) == 3
    assert report["sigma"]["bias"] == found.accelerometer.sigma[BIAS].tolist() and report["rests"] == 12
    assert report["sigma"]["scale"] == found.accelerometer.sigma[SCALE].tolist()
    assert report["sigma"]["misalignment"] == found.accelerometer.sigma[ANGLES].tolist()
    lines = "\n".join(calibration_lines(found))
    used = calibration_json(found)["used"]
    assert (used["accel_scale"], used["accel_misalignment"]) == (report["scale"], report["misalignment"])
    assert "accelerometer scale" in lines and "accelerometer misalignment" in lines and "gyroscope     bias" in lines


def test_six_flat_sides_leave_the_misalignment_open() -> None:
    unit = turned(2, FACES)
    found = calibrate_imu(unit.imu)
    report = calibration_json(found)["accelerometer"]
    assert found.accelerometer is not None
    assert (np.abs(errors_over_sigma(found.accelerometer, unit)) < 3.0).all()
    assert report["misalignment"] is None and report["sigma"]["misalignment"] is None and len(report["scale"]) == 3
    assert "misalignment needs more orientations" in " ".join(found.notes)
    assert found.used is not None and isinstance(found.used.accelerometer, AccelerometerCalibration)
    assert found.used.accelerometer.misalignment == (0.0, 0.0, 0.0)  # what is not known is not told


def test_with_what_it_is_told_the_estimation_feels_gravity_however_the_sensor_lies() -> None:
    unit = turned(3, TWELVE)
    found = calibrate_imu(unit.imu)
    assert found.used is not None and found.accelerometer is not None
    buffer = ImuBuffer(found.used, keep_s=1e6)
    buffer.add(unit.imu)
    T, bias = upper_triangular(unit.angles), unit.scale * unit.bias
    for rest in found.stillness.rests:
        begin_ns, end_ns = (
            round(1e9 * found.samples.t_s[i]) + int(unit.imu.t_robot_ns[0]) for i in (rest.start, rest.stop - 1)
        )
        forces = buffer.samples(begin_ns, end_ns).accel_imu.mean(axis=0)
        assert np.linalg.norm(forces - T @ bias) == pytest.approx(9.81, abs=5e-3)
        assert buffer.segment(begin_ns, end_ns).accel.mean(axis=0) == pytest.approx(forces, abs=5e-3)


def test_a_later_recording_on_one_side_keeps_the_errors_that_are_known() -> None:
    known = AccelerometerCalibration(scale=(1.02, 0.99, 1.0))
    told = msgspec.structs.replace(REFERENCE_IMU, accelerometer=known)
    found = calibrate_imu(turned(0, FACES[2:3]).imu, told)
    assert found.used is not None and found.used.accelerometer == known
    assert not any("misalignment" in line for line in calibration_lines(found) if not line.startswith("note"))


def test_a_unit_in_g_is_refused_on_all_sides_too() -> None:
    imu = turned(2, FACES).imu
    found = calibrate_imu(dataclasses.replace(imu, accel_imu=imu.accel_imu / 9.81))
    assert not found.accepted and found.accelerometer is None
    assert any("must be in m/s^2" in reason for reason in found.reasons)


def test_rests_in_a_hand_that_pushes_give_no_figures() -> None:
    unit = turned(4, TWELVE)
    rests = find_stillness(on_even_grid(unit.imu)).rests
    pushed = unit.imu.accel_imu.copy()
    for number, rest in enumerate(rests):
        pushed[rest] *= 1.0 + 0.05 * (-1) ** (number // 2)
    found = calibrate_imu(dataclasses.replace(unit.imu, accel_imu=pushed))
    assert found.accelerometer is None
    assert any("let go of it" in note for note in found.notes), found.notes
