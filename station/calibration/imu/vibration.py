"""How much running motors shake an inertial unit: a stretch with wheels in the air against one at rest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shared.geometry import FloatArray
from station.calibration.imu.sensor import BAND
from station.calibration.imu.spectrum import spectrum_of
from station.calibration.imu.still import EvenSamples

FROM_HZ = 1.0  # slower is bias and drift


@dataclass(frozen=True, slots=True)
class Shaking:
    """Of one sensor, its axes in the mean, while the motors run."""

    density: float  # unit / sqrt(Hz) at the frequencies that integration feels, below a tenth of the sample rate
    scatter: float  # unit; standard deviation, all frequencies from 1 Hz on
    strongest_hz: float  # where most of it is


def measure_shaking(samples: EvenSamples, columns: slice) -> Shaking:
    """Of columns 0 to 3 (gyroscope) or 3 to 6 (accelerometer)."""
    rate = samples.rate_hz
    axes = samples.values[:, columns].T
    spectra = [spectrum_of([axis[part] for part in samples.unbroken], rate, 0.5 * rate) for axis in axes]
    frequency, dof, design = spectra[0].frequency_hz, spectra[0].dof, spectra[0].design
    variance: FloatArray = np.mean([s.power for s in spectra], axis=0) / design[:, 0]  # of a coefficient of the signal
    low = (frequency >= FROM_HZ) & (frequency <= BAND * rate)
    felt = frequency >= FROM_HZ
    return Shaking(
        density=float(np.sqrt(np.average(variance[low], weights=dof[low]) / rate)),
        scatter=float(np.sqrt(np.average(variance[felt], weights=dof[felt]))),
        strongest_hz=float(frequency[felt][np.argmax(variance[felt])]),
    )
