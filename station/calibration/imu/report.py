"""An inertial unit's calibration as the JSON object and the sentences that `station calibrate imu` ends with."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from typing import Any

import numpy as np

from shared.calibration import AccelerometerCalibration, ImuNoise
from station.calibration.imu.calibrate import ImuCalibration
from station.calibration.imu.noise_fit import Estimate
from station.calibration.imu.sensor import SensorNoise
from station.calibration.imu.six_positions import ANGLES, BIAS, SCALE, AccelerometerErrors

# Name in the JSON object → attribute of Noise, its unit for the gyroscope and for the accelerometer.
FIGURES = {
    "noise_density": ("density", "rad/s/sqrt(Hz)", "m/s^2/sqrt(Hz)"),
    "random_walk": ("walk", "rad/s^2/sqrt(Hz)", "m/s^3/sqrt(Hz)"),
    "bias_instability": ("instability", "rad/s", "m/s^2"),
}


def calibration_json(found: ImuCalibration) -> dict[str, Any]:
    """Every figure with its 95 % interval; `value` is null where the recording tells only that, or an upper limit."""
    sensors = {"gyro": found.gyro, "accel": found.accel}
    figures = {
        f"{sensor}_{name}": None if noise is None else _figure(noise, attribute, units[sensor == "accel"])
        for name, (attribute, *units) in FIGURES.items()
        for sensor, noise in sensors.items()
    }
    rests = [(found.samples.t_s[rest.start], found.samples.t_s[rest.stop - 1]) for rest in found.stillness.rests]
    return {
        **figures,
        "used": _used_json(found.used) if found.accepted and found.used is not None else None,
        "gyro_bias": None if found.gyro_bias is None else found.gyro_bias.tolist(),
        "gravity": found.gravity,
        "accelerometer": None if found.accelerometer is None else _errors_json(found.accelerometer),
        "rate_hz": found.samples.rate_hz,
        "duration_s": found.samples.duration_s,
        "lost_samples": found.samples.num_lost,
        "rests": [{"begin_s": float(begin), "end_s": float(end)} for begin, end in rests],
        "moments": [asdict(moment) for moment in found.stillness.moments],
        "motors": None if found.shaking is None else dict(zip(sensors, map(asdict, found.shaking), strict=True)),
        "notes": list(found.notes),
        "accepted": found.accepted,
        "reasons": list(found.reasons),
    }


def _figure(sensor: SensorNoise, attribute: str, unit: str) -> dict[str, Any]:
    together: Estimate = getattr(sensor.noise, attribute)
    axes: list[Estimate] = [getattr(axis, attribute) for axis in sensor.axes]
    return {
        "value": together.value if together.is_known else None,
        "interval": [together.low, together.high],
        "unit": unit,
        "axes": [{"value": a.value if a.is_known else None, "interval": [a.low, a.high]} for a in axes],
    }


def _errors_json(errors: AccelerometerErrors) -> dict[str, Any]:
    """`misalignment` is null, and so is its sigma, where the rests do not tell it."""
    known = errors.angles_known
    return {
        "scale": errors.scale.tolist(),
        "misalignment": errors.angles.tolist() if known else None,
        "bias": errors.bias.tolist(),
        "sigma": {
            "scale": errors.sigma[SCALE].tolist(),
            "misalignment": errors.sigma[ANGLES].tolist() if known else None,
            "bias": errors.sigma[BIAS].tolist(),
        },
        "rms": errors.rms,
        "rests": errors.num_rests,
    }


def _used_json(used: ImuNoise) -> dict[str, Any]:
    """`accel_scale` and `accel_misalignment` are null where the accelerometer was never laid on its sides."""
    known = used.accelerometer if isinstance(used.accelerometer, AccelerometerCalibration) else None
    return {
        "gyro_noise_density": used.gyro_density,
        "gyro_random_walk": used.gyro_walk,
        "accel_noise_density": used.accel_density,
        "accel_random_walk": used.accel_walk,
        "rate_hz": used.rate_hz,
        "accel_scale": None if known is None else list(known.scale),
        "accel_misalignment": None if known is None else list(known.misalignment),
    }


def calibration_lines(found: ImuCalibration) -> Iterator[str]:
    """What a person reads."""
    for name, sensor in (("gyroscope", found.gyro), ("accelerometer", found.accel)):
        if sensor is None:
            continue
        for figure, (attribute, *units) in FIGURES.items():
            said = _said(getattr(sensor.noise, attribute))
            yield f"{name:13} {figure.replace('_', ' '):16} {said} {units[name == 'accelerometer']}"
    if found.gyro_bias is not None:
        yield f"{'gyroscope':13} {'bias':16} {' '.join(f'{b:.3g}' for b in found.gyro_bias)} rad/s"
    if found.accelerometer is not None:
        yield from _errors_lines(found.accelerometer)
    if found.shaking is not None:
        gyro, accel = found.shaking
        shaken = f"{gyro.scatter:.2g} rad/s and {accel.scatter:.2g} m/s^2"
        yield f"motors running: {shaken}, most at {accel.strongest_hz:.0f} Hz"
    yield from (f"note: {note}" for note in found.notes)
    yield from (f"refused: {reason}" for reason in found.reasons)


def _errors_lines(errors: AccelerometerErrors) -> Iterator[str]:
    figures = {
        "scale": (errors.scale, errors.sigma[SCALE], 5, ""),
        "bias": (errors.bias, errors.sigma[BIAS], 4, " m/s^2"),
    }
    if errors.angles_known:
        figures["misalignment"] = (np.degrees(errors.angles), np.degrees(errors.sigma[ANGLES]), 3, " degrees")
    for figure, (values, sigmas, digits, unit) in figures.items():
        axes = ", ".join(f"{v:.{digits}f} +- {s:.{digits}f}" for v, s in zip(values, sigmas, strict=True))
        yield f"{'accelerometer':13} {figure:16} {axes}{unit}"


def _said(estimate: Estimate) -> str:
    if not estimate.is_known:
        return f"{estimate.low:.3g} to {estimate.high:.3g}" if estimate.low > 0.0 else f"at most {estimate.high:.3g}"
    return f"{estimate.value:.3g} ({estimate.low:.3g} to {estimate.high:.3g})"
