"""When a recorded inertial unit lay still."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from shared.errors import DataError
from shared.geometry import FloatArray, so3_exp
from station.calibration.imu.still import find_stillness, on_even_grid
from station.model.frames import ImuBatch
from tests.support.inertial_noise import resting

pytestmark = pytest.mark.computing
RATE = 100.0


def without(imu: ImuBatch, keep: FloatArray) -> ImuBatch:
    return ImuBatch(imu.t_robot_ns[keep], imu.gyro_imu[keep], imu.accel_imu[keep])


def moved(imu: ImuBatch, gyro: FloatArray | float = 0.0, accel: FloatArray | float = 0.0) -> ImuBatch:
    return dataclasses.replace(imu, gyro_imu=imu.gyro_imu + gyro, accel_imu=imu.accel_imu + accel)


def between(imu: ImuBatch, begin_s: float, end_s: float) -> FloatArray:
    t_s = 1e-9 * (imu.t_robot_ns - imu.t_robot_ns[0])
    return np.asarray((t_s >= begin_s) & (t_s < end_s))


def test_an_undisturbed_recording_is_one_rest() -> None:
    found = find_stillness(on_even_grid(resting(1, 120.0, RATE)))
    assert found.rests == (slice(0, 12_000),)
    assert found.moments == ()


def test_a_long_undisturbed_recording_is_not_cut_by_its_own_random_walk() -> None:
    assert len(find_stillness(on_even_grid(resting(2, 3600.0, 50.0))).rests) == 1


def test_a_knock_is_named_and_cut_out() -> None:
    imu = resting(1, 60.0, RATE)
    knock = between(imu, 30.2, 30.4)[:, None] * np.random.default_rng(0).normal(0.0, 2.0, (len(imu), 3))
    samples = on_even_grid(moved(imu, accel=knock))
    found = find_stillness(samples)
    assert [(round(m.begin_s), round(m.end_s)) for m in found.moments] == [(30, 31)]
    assert found.rests == (slice(0, 3000), slice(3100, 6000))


def test_turning_slowly_and_evenly_is_motion_though_nothing_scatters() -> None:
    imu = resting(1, 60.0, RATE)
    found = find_stillness(on_even_grid(moved(imu, gyro=0.05 * between(imu, 20.0, 30.0)[:, None])))
    assert [(round(m.begin_s), round(m.end_s)) for m in found.moments] == [(20, 30)]


def test_a_unit_laid_down_otherwise_begins_another_rest() -> None:
    imu = resting(1, 60.0, RATE)
    tilted = so3_exp(np.array([np.radians(3.0), 0.0, 0.0])) @ np.array([0.0, 0.0, 9.81]) - np.array([0.0, 0.0, 9.81])
    found = find_stillness(on_even_grid(moved(imu, accel=np.outer(between(imu, 30.0, 60.0), tilted))))
    assert [round(rest.start / RATE) for rest in found.rests] == [0, 30]


def test_lost_samples_are_counted_and_short_gaps_filled() -> None:
    imu = resting(1, 60.0, RATE)
    keep = np.ones(len(imu), dtype=bool)
    keep[[100, 200, 201]] = False
    samples = on_even_grid(without(imu, keep))
    assert samples.num_lost == 3 and len(samples.t_s) == len(imu)
    assert samples.rate_hz == pytest.approx(RATE)
    np.testing.assert_allclose(samples.values[100], samples.values[[99, 101]].mean(axis=0))
    assert samples.unbroken == (slice(0, len(imu)),)


def test_a_long_gap_parts_the_recording() -> None:
    imu = resting(1, 60.0, RATE)
    samples = on_even_grid(without(imu, ~between(imu, 20.0, 25.0)))
    assert samples.num_lost == 500
    assert [part.stop for part in samples.unbroken] == [2000, 5500]
    assert samples.t_s[1999] == pytest.approx(19.99) and samples.t_s[2000] == pytest.approx(25.0)
    assert len(find_stillness(samples).rests) == 2


def test_the_rate_comes_from_whole_steps_even_where_stamps_are_rough() -> None:
    imu = resting(1, 60.0, 225.0)
    jitter = np.random.default_rng(0).integers(-400_000, 400_000, len(imu))
    samples = on_even_grid(dataclasses.replace(imu, t_robot_ns=imu.t_robot_ns + jitter))
    assert samples.rate_hz == pytest.approx(225.0, rel=1e-4) and samples.num_lost == 0


@pytest.mark.parametrize("times", [[0], [0, 10, 10, 20], [0, 20, 10, 30]])
def test_stamps_that_do_not_increase_are_refused(times: list[int]) -> None:
    zeros = np.zeros((len(times), 3))
    with pytest.raises(DataError, match="in order of time"):
        on_even_grid(ImuBatch(np.array(times), zeros, zeros))
