"""How well the calibration that a robot tells explains what its camera and IMU measured."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np

from shared.geometry import FloatArray

FitVerdict = Literal["fits", "does not fit", "not known yet"]
FITS: Final = "fits"
MISFITS: Final = "does not fit"
UNKNOWN: Final = "not known yet"

_MISFITS_BECAUSE: Final = "the calibration does not fit:"
REMEDY: Final = (
    "calibrate the camera, or carry the robot about by hand for half a minute: *Calibrate*, *Check* on the page, or"
    " `station calibrate check RECORDING.mcap --out calibration.yaml` of a recording, says what is off"
)

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
# Tracking that is given up because image and IMU contradict each other: how often that is with a right calibration
# (a knock, a person who walks through the view), generously. With one that is far off it is ten to thirty times.
CONTRADICTIONS_PER_S = 1.0 / 60.0
UNLIKELY = 1e-4  # of that many by chance: asked after each, some dozens a drive at most


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
    is_contradicted: bool = False  # image and IMU were at odds so often that the numbers above are not to be relied on

    def __post_init__(self) -> None:
        """Raises ValueError: a focal length that none has."""
        if not self.focal_scale > 0:
            raise ValueError(f"a calibration's fit says that its focal length is {self.focal_scale} times the told one")


@dataclass(frozen=True, slots=True)
class _Excess:
    """An error beyond what is borne, as far as anybody knows."""

    what: str
    give_or_take: str  # one standard deviation
    is_known: bool


def why_misfit(fit: CalibrationFit | None) -> str:
    """In a sentence; empty where nothing says that the calibration does not fit."""
    return fit.sentence if fit is not None and fit.verdict == MISFITS else ""


def why_doubtful(fit: CalibrationFit | None) -> str:
    """As `why_misfit`, and where it seems not to fit although the drive was too short to know."""
    return (
        fit.sentence if fit is not None and fit.verdict != FITS and (_excesses(fit) or fit.verdict == MISFITS) else ""
    )


def why_unsure(fit: CalibrationFit | None) -> str:
    """As `why_misfit`, but empty too where what does not fit is near enough, less its sigma, to be corrected."""
    if fit is None or fit.is_contradicted:
        return why_misfit(fit)
    surely_turned = _drawn_to_zero(np.array(fit.mounting_deg), np.array(fit.mounting_sigma_deg))
    turns = _turns(replace(fit, mounting_deg=_three(surely_turned)))
    is_other = any(excess.is_known for excess in (*turns, *_shifts(fit)))  # nothing corrects a time shift
    return why_misfit(fit) if is_other or _is_far(fit) else ""


def newer(before: CalibrationFit | None, now: CalibrationFit) -> CalibrationFit:
    """What is known of a calibration once another drive speaks of it: drives say nothing sure at first."""
    return before if before is not None and now.verdict == UNKNOWN != before.verdict else now


def contradicted(fit: CalibrationFit, times: int, within_s: float) -> CalibrationFit:
    """The fit, given that tracking was lost so many times because image and IMU contradicted each other.

    Of a calibration that is far off (another lens than the told one) windows of sound tracking are rare and say little,
    each from its own mistaken poses; that there are hardly any says enough. Where they do say something, it stands.
    """
    if fit.verdict != UNKNOWN or _chance(times, CONTRADICTIONS_PER_S * within_s) > UNLIKELY:
        return fit
    seems = "".join(f", {excess.what}, give or take {excess.give_or_take}" for excess in _excesses(fit))
    what = f"image and IMU contradicted each other {times} times in {within_s:.0f} s{seems}"
    return replace(fit, verdict=MISFITS, sentence=f"{_MISFITS_BECAUSE} {what}; {REMEDY}", is_contradicted=True)


def _chance(times: int, expected: float) -> float:
    """Of so many or more, by Poisson's distribution. By hand: SciPy would be loaded by every command."""
    fewer, term = 0.0, math.exp(-expected)
    for k in range(times):
        fewer += term
        term *= expected / (k + 1)
    return 1.0 - fewer


def judge(
    focal: tuple[float, float], mounting_deg: FloatArray, mounting_sigma_deg: FloatArray, shift_s: tuple[float, float]
) -> CalibrationFit:
    """The fit and what it means.

    Args:
        focal: scale and its standard deviation; shift_s: likewise.
        mounting_deg, mounting_sigma_deg: (3,).
    """
    turned, turned_sigma = _three(mounting_deg), _three(mounting_sigma_deg)
    fit = CalibrationFit(*focal, turned, turned_sigma, *shift_s, verdict=UNKNOWN, sentence="")
    excesses = _excesses(fit)
    if misfits := [excess.what for excess in excesses if excess.is_known]:
        return replace(fit, verdict=MISFITS, sentence=f"{_MISFITS_BECAUSE} {', '.join(misfits)}; {REMEDY}")
    if not excesses and _is_focal_known(fit):
        said = f"what the drive says of the focal length is {abs(_focal_error(fit)):.1%} from it"
        return replace(fit, verdict=FITS, sentence=f"the calibration fits: {said}")
    seems = ", ".join(f"{excess.what}, give or take {excess.give_or_take}" for excess in excesses)
    so_far = f" (so far {seems})" if seems else ""
    return replace(
        fit, sentence=f"whether the calibration fits is not known yet{so_far}: drive on, and turn in both directions"
    )


def _drawn_to_zero(values: FloatArray, sigma: FloatArray) -> FloatArray:
    """By one standard deviation, at most to zero."""
    return np.asarray(np.sign(values) * np.maximum(np.abs(values) - sigma, 0.0))


def _focal_error(fit: CalibrationFit) -> float:
    """Of what is told, as a share."""
    return 1.0 / fit.focal_scale - 1.0


def _is_focal_known(fit: CalibrationFit) -> bool:
    return fit.focal_sigma <= SURE * MAX_FOCAL_ERROR


def _is_far(fit: CalibrationFit) -> bool:
    """Whether what is told is too far off to correct it."""
    return abs(_focal_error(fit)) - fit.focal_sigma > MAX_CORRECTED_FOCAL_ERROR


def _excesses(fit: CalibrationFit) -> list[_Excess]:
    return [*_focal_excess(fit), *_turns(fit), *_shifts(fit)]


def _focal_excess(fit: CalibrationFit) -> list[_Excess]:
    error = _focal_error(fit)
    if abs(error) <= MAX_FOCAL_ERROR:
        return []
    what = f"the focal length seems {abs(error):.1%} too {'long' if error > 0 else 'short'}"
    return [_Excess(what, f"{fit.focal_sigma:.1%}", _is_focal_known(fit))]


def _turns(fit: CalibrationFit) -> list[_Excess]:
    """About the axes of which it is known that the camera is turned; and about those of which it is not."""
    turned, sigma = np.array(fit.mounting_deg), np.array(fit.mounting_sigma_deg)
    is_known = sigma <= SURE * MAX_MOUNTING_DEG
    axes = [(known, (np.abs(turned) > MAX_MOUNTING_DEG) & (is_known == known)) for known in (True, False)]
    return [
        _Excess(f"the camera seems turned by {_norm(turned[of]):.1f} degrees", f"{_norm(sigma[of]):.1f} degrees", known)
        for known, of in axes
        if of.any()
    ]


def _shifts(fit: CalibrationFit) -> list[_Excess]:
    shift_s, sigma_s = fit.time_shift_s, fit.time_shift_sigma_s
    if abs(shift_s) <= MAX_TIME_SHIFT_S:
        return []
    what = f"images seem taken {1e3 * abs(shift_s):.0f} ms {'later' if shift_s > 0 else 'earlier'} than told"
    return [_Excess(what, f"{1e3 * sigma_s:.0f} ms", sigma_s <= SURE * MAX_TIME_SHIFT_S)]


def _norm(values: FloatArray) -> float:
    return float(np.linalg.norm(values))


def _three(values: FloatArray) -> tuple[float, float, float]:
    x, y, z = values.tolist()
    return x, y, z
