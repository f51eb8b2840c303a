"""A recording of an inertial unit at rest → its noise, what the estimation is told of it, and whether that holds."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import msgspec
import numpy as np

from shared.calibration import AccelerometerCalibration, ImuNoise
from shared.geometry import FloatArray
from shared.sensor_yaml import CONSUMER_IMU
from station.calibration.imu.noise_fit import FLAT_SHARE, Estimate, Noise
from station.calibration.imu.sensor import SensorNoise, measure_sensor
from station.calibration.imu.six_positions import (
    MOST_RMS,
    AccelerometerErrors,
    RestForces,
    fit_errors,
    missing_orientations,
    rest_forces,
)
from station.calibration.imu.still import EvenSamples, Stillness, find_stillness, on_even_grid
from station.calibration.imu.vibration import Shaking, measure_shaking
from station.model.frames import ImuBatch

MIN_REST_S = 60.0  # white noise is known to some 5 % from there on
WALK_REST_S = 300.0  # shorter rests do not tell a random walk from flicker
ADVISED_S = 1800.0
MAX_LOST = 0.02  # share of samples
GRAVITY_TOLERANCE = 0.1  # cheap units are off by 3 %; what is further off has another unit of measure
MAX_BIAS_RAD_S = 0.35  # 20 degrees/s: the worst of cheap gyroscopes are off by less
MOST_FOREIGN = 0.3  # of the white noise's standard deviation: it was shaken all the time
COARSE = 3.0  # steps of the readings per standard deviation of the noise, above which the noise does not show
# Ten times the worst of MEMS data sheets: it moved, or the readings are in another unit of measure.
WORST = {"gyro_density": 5e-3, "gyro_walk": 3e-3, "accel_density": 0.05, "accel_walk": 0.05}
GYRO, ACCEL = slice(0, 3), slice(3, 6)
DENSITY, WALK = "density", "walk"


@dataclass(frozen=True, slots=True, eq=False)
class ImuCalibration:
    """What a recording tells of an inertial unit, and whether it can be used."""

    samples: EvenSamples
    stillness: Stillness
    gyro: SensorNoise | None  # None: it never lay still for long enough
    accel: SensorNoise | None
    used: ImuNoise | None  # what the estimation is told
    shaking: tuple[Shaking, Shaking] | None  # gyroscope and accelerometer, while the motors run
    gyro_bias: FloatArray | None  # (3,) rad/s
    gravity: float | None  # m/s^2, the mean force at rest
    accelerometer: AccelerometerErrors | None  # None: it did not lie on enough sides; where it was turned, a note
    notes: tuple[str, ...]  # what it cannot tell, or what was cut out of it
    reasons: tuple[str, ...]  # why it cannot be used

    @property
    def accepted(self) -> bool:
        return not self.reasons


def calibrate_imu(
    imu: ImuBatch, told: ImuNoise | None = None, motors: ImuBatch | None = None, gravity: float = 9.81
) -> ImuCalibration:
    """The noise of an inertial unit from a recording at rest; its accelerometer's errors if it rested on its sides.

    Args:
        imu: the recording; when it was moved is found and cut out.
        told: its ranges, at which readings are saturated, and the accelerometer's errors, unless found anew, are kept.
        motors: it, resting, with its motors running.
        gravity: m/s^2, where it was recorded.
    Raises:
        DataError: hardly any samples, or not in order of time.
    """
    samples = on_even_grid(imu)
    stillness = find_stillness(samples)
    shaken = None if motors is None else on_even_grid(motors)
    shaking = None if shaken is None else (measure_shaking(shaken, GYRO), measure_shaking(shaken, ACCEL))
    longest = _longest_s(stillness, samples)
    too_short = (_too_restless(longest, stillness, samples),) if longest < MIN_REST_S else ()
    unfit = (*too_short, *_unfit(samples, stillness, told))
    if not stillness.rests or len(unfit) > len(too_short):
        lost = _lost_note(samples)
        return ImuCalibration(samples, stillness, None, None, None, shaking, None, None, None, lost, unfit)
    rests = [samples.values[rest] for rest in stillness.rests]
    gyro, accel = (_measured(rests, columns, samples.rate_hz, longest) for columns in (GYRO, ACCEL))
    at_rest = np.concatenate(rests)
    forces = rest_forces(samples, stillness.rests)
    accelerometer, told_by_sides = _accelerometer(forces, accel, gravity)
    return ImuCalibration(
        samples=samples,
        stillness=stillness,
        gyro=gyro,
        accel=accel,
        used=_used(gyro, accel, shaking, samples.rate_hz, told, accelerometer),
        shaking=shaking,
        gyro_bias=at_rest[:, GYRO].mean(axis=0),
        gravity=forces.mean_length(),
        accelerometer=accelerometer,
        notes=(*_lost_note(samples), *_notes(samples, stillness, gyro, accel, longest), *told_by_sides),
        reasons=(
            *too_short,
            *_not_its_noise("gyroscope", "gyro", gyro, samples),
            *_not_its_noise("accelerometer", "accel", accel, samples),
        ),
    )


def _longest_s(stillness: Stillness, samples: EvenSamples) -> float:
    return max(((rest.stop - rest.start) / samples.rate_hz for rest in stillness.rests), default=0.0)


def _measured(rests: list[FloatArray], columns: slice, rate_hz: float, longest_s: float) -> SensorNoise:
    found = measure_sensor([rest[:, columns] for rest in rests], rate_hz)
    if longest_s >= WALK_REST_S and not found.drifts:
        return found
    x, y, z = (replace(axis, walk=replace(axis.walk, low=0.0)) for axis in found.axes)
    together = replace(found.noise, walk=replace(found.noise.walk, low=0.0))
    return replace(found, noise=together, axes=(x, y, z))


# What makes a recording unfit


def _too_restless(longest_s: float, stillness: Stillness, samples: EvenSamples) -> str:
    if samples.duration_s < MIN_REST_S:
        return (
            f"the recording lasts {samples.duration_s:.0f} s, and the noise needs {MIN_REST_S:.0f} s at rest;"
            f" record {ADVISED_S / 60:.0f} minutes"
        )
    return (
        f"it lay still for {longest_s:.0f} s at most (moved {len(stillness.moments)} times), and the noise needs"
        f" {MIN_REST_S:.0f} s; lay it on a heavy table or the floor, motors off, and leave it alone"
    )


def _unfit(samples: EvenSamples, stillness: Stillness, told: ImuNoise | None) -> Iterator[str]:
    lost = samples.num_lost / (samples.num_lost + len(samples.t_s))
    if lost > MAX_LOST:
        yield f"{100 * lost:.1f} % of the samples were lost; mend the link or lower the rate, and record again"
    scatter = np.diff(samples.values, axis=0).std(axis=0) / math.sqrt(2.0)
    step = np.array([_step(column) for column in samples.values.T])
    for name, columns in (("gyroscope", GYRO), ("accelerometer", ACCEL)):
        if (scatter[columns] <= step[columns] / COARSE).any():
            yield f"an axis of the {name} hardly changes; it is broken, or too coarse: set a smaller range"
    usual = np.median(samples.values, axis=0)
    forces = rest_forces(samples, stillness.rests)
    force = forces.mean_length() if stillness.rests else float(np.linalg.norm(usual[ACCEL]))
    rate = float(np.abs(usual[GYRO]).max())
    if abs(force / 9.81 - 1.0) > GRAVITY_TOLERANCE:
        yield f"at rest the accelerometer reads {force:.3g} and not 9.8; it must be in m/s^2, gravity included"
    if rate > MAX_BIAS_RAD_S:
        yield f"at rest the gyroscope reads {rate:.2g}; it must be in rad/s, and must not turn"
    at_rest = np.concatenate([np.empty((0, 6)), *(samples.values[rest] for rest in stillness.rests)])
    if told is not None and (np.abs(at_rest) >= 0.99 * np.repeat([told.gyro_range, told.accel_range], 3)).any():
        yield "readings at rest are at the end of the sensor's range; set a larger range"


def _step(values: FloatArray) -> float:
    """The smallest difference of two readings: what the sensor's number of bits leaves."""
    distinct = np.unique(values[:20_000])
    return float(np.diff(distinct).min()) if len(distinct) > 1 else 0.0


def _not_its_noise(name: str, key: str, sensor: SensorNoise, samples: EvenSamples) -> Iterator[str]:
    """What was measured, but cannot be a sensor's own noise."""
    noise = sensor.noise
    sigma = noise.density.value * math.sqrt(samples.rate_hz)
    if sensor.foreign_rms > MOST_FOREIGN * sigma:
        yield (
            f"something shook the {name} all the time, most at {sensor.foreign_hz[0]:.2g} Hz;"
            " lay it on a heavy table or the floor, away from motors, fans and steps"
        )
    for figure, estimate in ((DENSITY, noise.density), (WALK, noise.walk)):
        if estimate.low > WORST[f"{key}_{figure}"]:
            what = "noise" if figure == DENSITY else "random walk"
            yield f"the {name}'s {what} is larger than any such sensor's; it was moved, or is not in SI units"


def _accelerometer(
    rests: RestForces, accel: SensorNoise, gravity: float
) -> tuple[AccelerometerErrors | None, tuple[str, ...]]:
    """Its scale, misalignment and bias, and what to do where the rests do not tell all of them."""
    if rests.num_orientations() == 1:
        return None, ()  # nobody tried
    if missing := tuple(missing_orientations(rests)):
        return None, missing
    found = fit_errors(rests, _noisiest(accel, DENSITY), used_walk(accel, CONSUMER_IMU["accel_walk"]), gravity)
    if found.rms > MOST_RMS:
        return None, (
            f"the rests' forces differ by {found.rms:.2g} m/s^2 whatever the accelerometer's scale and bias;"
            " let go of it in each orientation, and record again",
        )
    if not found.angles_known:
        return found, (
            "the accelerometer's misalignment needs more orientations: lean it on its edges as well, twelve in all,"
            " after a longer rest",
        )
    return found, ()


# What is said beside


def _lost_note(samples: EvenSamples) -> tuple[str, ...]:
    gaps = len(samples.unbroken) - 1
    if not samples.num_lost:
        return ()
    return (f"{samples.num_lost} samples are missing" + (f", with {gaps} longer gaps" if gaps else ""),)


def _notes(
    samples: EvenSamples, stillness: Stillness, gyro: SensorNoise, accel: SensorNoise, longest_s: float
) -> Iterator[str]:
    if stillness.moments:
        first = ", ".join(f"{m.begin_s:.0f} s" for m in stillness.moments[:5])
        more = ", ..." if len(stillness.moments) > 5 else ""
        yield f"it was moved {len(stillness.moments)} times ({first}{more}); these moments are cut out"
    if MIN_REST_S <= longest_s < WALK_REST_S:
        yield (
            f"{longest_s / 60:.1f} minutes at rest tell the white noise and only an upper limit of the random walks;"
            f" these need 5 minutes, better {ADVISED_S / 60:.0f}"
        )
    for name, sensor in (("gyroscope", gyro), ("accelerometer", accel)):
        walk = sensor.noise.walk
        if longest_s >= WALK_REST_S and not walk.is_known and not sensor.drifts:
            if walk.low > 0.0:
                told = f"tell the {name}'s random walk from its flicker: it is {walk.low:.2g} to {walk.high:.2g}"
            else:
                told = f"show the {name}'s random walk: it is {walk.high:.2g} at most"
            yield f"{longest_s / 60:.0f} minutes do not {told}; longer ones may"
        if sensor.drifts:
            yield f"the {name} drifted, as while warming up; switch it on 10 minutes before: the random walk is a limit"
        if sensor.foreign_hz:
            yield f"the {name} was shaken at {sensor.foreign_hz[0]:.2g} Hz; that is left out"
        low, high = (f([axis.density.value for axis in sensor.axes]) for f in (min, max))
        if high > 1.5 * low:
            yield f"the {name}'s axes are unequal: {low:.2g} to {high:.2g}"
        if sensor.band_hz < 0.99 * samples.rate_hz / 10:
            yield f"the {name} filters its own readings; its noise is taken from below {sensor.band_hz:.2g} Hz"


# What the estimation is told


def _used(
    gyro: SensorNoise,
    accel: SensorNoise,
    shaking: tuple[Shaking, Shaking] | None,
    rate_hz: float,
    told: ImuNoise | None,
    accelerometer: AccelerometerErrors | None,
) -> ImuNoise:
    """The measured figures, a consumer unit's where one is not known, and the motors' shaking where it is more."""
    shaken = (0.0, 0.0) if shaking is None else (shaking[0].density, shaking[1].density)
    return ImuNoise(
        gyro_density=max(shaken[0], _noisiest(gyro, DENSITY)),
        accel_density=max(shaken[1], _noisiest(accel, DENSITY)),
        gyro_walk=used_walk(gyro, CONSUMER_IMU["gyro_walk"]),
        accel_walk=used_walk(accel, CONSUMER_IMU["accel_walk"]),
        rate_hz=rate_hz,
        gyro_range=math.inf if told is None else told.gyro_range,
        accel_range=math.inf if told is None else told.accel_range,
        accelerometer=_errors_told(accelerometer, told),
    )


def _errors_told(
    found: AccelerometerErrors | None, told: ImuNoise | None
) -> AccelerometerCalibration | msgspec.UnsetType:
    """What is measured now, or was before."""
    if found is not None:
        return found.told
    return msgspec.UNSET if told is None else told.accelerometer


def _noisiest(sensor: SensorNoise, figure: str) -> float:
    """The axes' common figure, or what the noisiest of them certainly has."""
    axes: list[Estimate] = [getattr(axis, figure) for axis in sensor.axes]
    common: Estimate = getattr(sensor.noise, figure)
    return max(common.value, *(axis.low for axis in axes))


def used_walk(sensor: SensorNoise, consumer: float) -> float:
    """A random walk that stands for the sensor's flicker as well, which the estimation does not model.

    With it, white noise and random walk have at least 0.83 of the true Allan variance at every averaging time: it meets
    the flicker's where white noise falls below it, so K^2 tau / 3 = c at tau = N^2 / c, c the flicker's variance.
    """
    noise: Noise = sensor.noise
    walk = _noisiest(sensor, WALK) if noise.walk.is_known else min(max(consumer, noise.walk.low), noise.walk.high)
    flat = FLAT_SHARE * noise.instability.value**2
    return math.hypot(walk, math.sqrt(3.0) * flat / noise.density.value)
