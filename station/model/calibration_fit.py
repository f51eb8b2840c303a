"""How well the calibration that a robot tells explains what its camera and IMU measured."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from shared.geometry import FloatArray

FitVerdict = Literal["fits", "does not fit", "not known yet"]
FITS: Final = "fits"
MISFITS: Final = "does not fit"
UNKNOWN: Final = "not known yet"

# 2 % of focal length, 1 degree and 5 ms are borne: answers stay right. 3 % gives wrong ones. So half way between those,
# less the tenth by which a focal length that is told too long is underestimated, since the tracker keeps what fits what
# it was told (docs/robot.md). Of the other two, the double: nothing wrong was seen there.
MAX_FOCAL_ERROR = 0.0225
MAX_MOUNTING_DEG = 2.0
MAX_TIME_SHIFT_S = 0.010
# Of 5 % a fit has said 3: corrected by that (best_camera.py), more is left than is borne. Less its standard deviation,
# since 2 % have been taken for nearly 3, and are borne.
MAX_CORRECTED_FOCAL_ERROR = 0.025
SURE = 1.0 / 3.0  # an error is known when its standard deviation is at most this share of what is borne


@dataclass(frozen=True, slots=True)
class CalibrationFit:
    """What the data say of the calibration, with one standard deviation each."""

    focal_scale: float  # the focal length that the data want, over the told one: 0.97 where that is 3 % too long
    focal_sigma: float
    mounting_deg: tuple[float, float, float]  # the camera is turned by that, about its own axes: right, down, forward
    mounting_sigma_deg: tuple[float, float, float]
    time_shift_s: float  # to be added to the calibration's
    time_shift_sigma_s: float
    verdict: FitVerdict
    sentence: str  # for a person


def why_misfit(fit: CalibrationFit | None) -> str:
    """In a sentence; empty where nothing says that the calibration does not fit."""
    return fit.sentence if fit is not None and fit.verdict == MISFITS else ""


def why_unsure(fit: CalibrationFit | None) -> str:
    """As `why_misfit`, but empty too where what does not fit is near enough, less its sigma, to be corrected."""
    if fit is None:
        return ""
    mounting_sigma, shift_sigma = np.array(fit.mounting_sigma_deg), fit.time_shift_sigma_s
    mounting = _drawn_to_zero(np.array(fit.mounting_deg), mounting_sigma)
    shift = float(_drawn_to_zero(np.array(fit.time_shift_s), np.array(shift_sigma)))
    other = _other_misfits(mounting, mounting_sigma, (shift, shift_sigma))
    return why_misfit(fit) if other or _is_far(fit) else ""


def worst(fits: Iterable[CalibrationFit | None]) -> CalibrationFit | None:
    """One that does not fit, where there is one; else one that is known, else None."""
    order = (MISFITS, FITS, UNKNOWN)
    known = [fit for fit in fits if fit is not None]
    return min(known, key=lambda fit: order.index(fit.verdict), default=None)


def judge(
    focal: tuple[float, float], mounting_deg: FloatArray, mounting_sigma_deg: FloatArray, shift_s: tuple[float, float]
) -> CalibrationFit:
    """The fit and what it means.

    Args:
        focal: scale and its standard deviation; shift_s: likewise.
        mounting_deg, mounting_sigma_deg: (3,).
    """
    scale, sigma = focal
    error = 1.0 / scale - 1.0  # of what is told
    is_sure = sigma <= SURE * MAX_FOCAL_ERROR
    misfits = other = _other_misfits(mounting_deg, mounting_sigma_deg, shift_s)
    if is_sure and abs(error) > MAX_FOCAL_ERROR:
        misfits = [f"the focal length seems {abs(error):.1%} too {'long' if error > 0 else 'short'}", *other]
    if misfits:
        verdict: FitVerdict = MISFITS
        sentence = f"the calibration does not fit: {', '.join(misfits)}; calibrate the camera"
    elif is_sure:
        verdict = FITS
        sentence = f"the calibration fits: what the drive says of the focal length is {abs(error):.1%} from it"
    else:
        verdict = UNKNOWN
        sentence = "whether the calibration fits is not known yet: drive on, and turn in both directions"
    return CalibrationFit(
        focal_scale=scale,
        focal_sigma=sigma,
        mounting_deg=_three(mounting_deg),
        mounting_sigma_deg=_three(mounting_sigma_deg),
        time_shift_s=shift_s[0],
        time_shift_sigma_s=shift_s[1],
        verdict=verdict,
        sentence=sentence,
    )


def _drawn_to_zero(values: FloatArray, sigma: FloatArray) -> FloatArray:
    """By one standard deviation, at most to zero."""
    return np.asarray(np.sign(values) * np.maximum(np.abs(values) - sigma, 0.0))


def _is_far(fit: CalibrationFit) -> bool:
    """Whether what is told is too far off to correct it."""
    return abs(1.0 / fit.focal_scale - 1.0) - fit.focal_sigma > MAX_CORRECTED_FOCAL_ERROR


def _other_misfits(mounting_deg: FloatArray, mounting_sigma_deg: FloatArray, shift_s: tuple[float, float]) -> list[str]:
    """What does not fit beside the focal length."""
    misfits = []
    turned = mounting_deg[(np.abs(mounting_deg) > MAX_MOUNTING_DEG) & (mounting_sigma_deg <= SURE * MAX_MOUNTING_DEG)]
    if len(turned):
        misfits.append(f"the camera seems turned by {np.linalg.norm(turned):.1f} degrees")
    if abs(shift_s[0]) > MAX_TIME_SHIFT_S and shift_s[1] <= SURE * MAX_TIME_SHIFT_S:
        when = "later" if shift_s[0] > 0 else "earlier"
        misfits.append(f"images seem taken {1e3 * abs(shift_s[0]):.0f} ms {when} than told")
    return misfits


def _three(values: FloatArray) -> tuple[float, float, float]:
    x, y, z = values.tolist()
    return x, y, z
