"""The noise of one sensor, gyroscope or accelerometer, from its rests: three axes, and what does not belong to it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.special import chdtri

from shared.geometry import FloatArray
from station.calibration.imu.allan import AllanCurve, allan_deviation
from station.calibration.imu.noise_fit import Noise, fit_noise, most_likely
from station.calibration.imu.spectrum import Spectrum, pooled, spectrum_of

# Above it sensors filter, and parts of the robot ring. What integration makes of the noise is decided far below.
BAND = 0.1  # of the sample rate
NARROWEST_HZ = 0.5
FILTERED = 0.8  # of the expected power: a sensor's own low-pass filter shows
STRANGE = 1e-7  # chance that a band of the model's noise holds so much power
MAX_ROUNDS = 6
DRIFT_CYCLES = 5.0  # excess slower than this over the recording is drift: warming up


@dataclass(frozen=True, slots=True, eq=False)
class SensorNoise:
    """What one sensor adds to the truth at rest."""

    noise: Noise  # root mean square over the axes
    axes: tuple[Noise, Noise, Noise]
    curves: tuple[AllanCurve, AllanCurve, AllanCurve]
    band_hz: float  # up to where the spectrum was fitted
    foreign_hz: tuple[float, ...]  # frequencies of what is no noise of the sensor, left out; the strongest first
    foreign_rms: float  # how much that is, the sensor's unit
    drifts: bool  # more at the lowest frequencies than the noise explains


def measure_sensor(rests: Sequence[FloatArray], rate_hz: float) -> SensorNoise:
    """Noise of three axes from their rests (n_i, 3)."""
    band, spectra = BAND * rate_hz, _spectra(rests, rate_hz, BAND * rate_hz)
    keep = _is_own(spectra)
    while band / 2 >= NARROWEST_HZ and _is_filtered(spectra, keep, band):
        band /= 2
        spectra = _spectra(rests, rate_hz, band)
        keep = _is_own(spectra)
    own = [spectrum.chosen(keep) for spectrum in spectra]
    expected = [spectrum.design @ most_likely(spectrum) for spectrum in own]
    is_slow = spectra[0].frequency_hz < DRIFT_CYCLES * rate_hz / max(map(len, rests))
    x, y, z = (fit_noise(spectrum) for spectrum in own)
    return SensorNoise(
        noise=fit_noise(pooled(own, expected)),
        axes=(x, y, z),
        curves=_curves(rests, rate_hz),
        band_hz=band,
        foreign_hz=_strongest_first(spectra, ~keep & ~is_slow),
        foreign_rms=_rms(spectra, ~keep & ~is_slow, sum(map(len, rests))),
        drifts=bool((~keep & is_slow).any()),
    )


def _spectra(rests: Sequence[FloatArray], rate_hz: float, max_hz: float) -> list[Spectrum]:
    return [spectrum_of([rest[:, axis] for rest in rests], rate_hz, max_hz) for axis in range(3)]


def _is_own(spectra: Sequence[Spectrum]) -> npt.NDArray[np.bool_]:
    """Which bands hold nothing but the sensor's noise, on all three axes. Where most of them do not, all stay."""
    limit = chdtri(spectra[0].dof, STRANGE) / spectra[0].dof
    keep = np.ones(len(spectra[0]), dtype=np.bool_)
    for _ in range(MAX_ROUNDS):
        excess = np.max([_ratio(spectrum, keep) for spectrum in spectra], axis=0) / limit
        found = keep & (excess > max(1.0, 0.3 * float(excess[keep].max())))  # the worst first: they lift the model
        if not found.any():
            break
        keep &= ~found
    return keep if keep.mean() > 0.5 else np.ones_like(keep)


def _ratio(spectrum: Spectrum, keep: npt.NDArray[np.bool_]) -> FloatArray:
    """(n,) Power over what the noise of the kept bands lets expect."""
    return spectrum.power / (spectrum.design @ most_likely(spectrum.chosen(keep)))


def _is_filtered(spectra: Sequence[Spectrum], keep: npt.NDArray[np.bool_], band_hz: float) -> bool:
    """Whether the upper half of the band has less than the lower half lets expect."""
    lower = keep & (spectra[0].frequency_hz < band_hz / 2)
    upper = keep & ~lower
    if lower.sum() < 3 or not upper.any():
        return False
    dof = spectra[0].dof[upper]
    ratios = [float(np.average(_ratio(spectrum, lower)[upper], weights=dof)) for spectrum in spectra]
    return min(ratios) < FILTERED


def _strongest_first(spectra: Sequence[Spectrum], rows: npt.NDArray[np.bool_]) -> tuple[float, ...]:
    held = np.max([s.dof * s.power / s.design[:, 0] for s in spectra], axis=0)[rows]
    return tuple(spectra[0].frequency_hz[rows][np.argsort(-held)].tolist())


def _rms(spectra: Sequence[Spectrum], rows: npt.NDArray[np.bool_], num_samples: int) -> float:
    """Of what those bands hold, on the worst axis: the sum of squares that the transform keeps (Parseval)."""
    if not rows.any():
        return 0.0
    return max(float(np.sqrt(np.sum((s.dof * s.power / s.design[:, 0])[rows]) / num_samples)) for s in spectra)


def _curves(rests: Sequence[FloatArray], rate_hz: float) -> tuple[AllanCurve, AllanCurve, AllanCurve]:
    x, y, z = (allan_deviation([rest[:, axis] for rest in rests], rate_hz) for axis in range(3))
    return x, y, z
