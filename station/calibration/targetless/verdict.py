"""What a recording without a target can tell of a calibration, and whether what was found can be believed.

What is observable is asked of the motion and of honest standard deviations, never of how near the result is to what was
told. Each refusal says what to do.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import floor, log10

import numpy as np

from shared.calibration import CameraCalibration
from shared.geometry import FloatArray, so3_log
from station.calibration.camera_imu.rows import Samples
from station.calibration.camera_imu.start import MAX_SHIFT_S, TurningMatch
from station.calibration.camera_imu.unknowns import DELAY, MOUNT_POSITION, MOUNT_ROTATION, SHIFT
from station.calibration.camera_imu.verdict import TURNS
from station.calibration.targetless.batch import Solution

MIN_DURATION_S = 3.0
MAX_SILENCE_S = 0.5  # of the IMU
MIN_RATE = 0.05  # rad/s RMS: less, and the turning is little more than what drifts in the tracks
MIN_SECOND_RATE = 0.05  # about the axis that it turned second most about
MAX_UNEXPLAINED = 0.3  # of the turning's variance
MAX_PLANAR = 0.9  # of the corners: a board on a wall has all of them in one plane, a flight through a hall two thirds
MIN_APART = 3.0  # by how much worse the second best time shift must be
MAX_LEFT_OUT = 0.5  # of the sightings: more, and the scene moves rather than the camera
MAX_PX = 1.0  # left over: of followed corners it is 0.1 to 0.4
MAX_NOISE_RATIO = 12.0  # of the IMU's residuals to the noise that was told: propellers make it some five times
# The batch estimate starts from turning alone, which is good to a degree and some milliseconds.
MAX_TURNED_DEG, MAX_SHIFTED_S = 3.0, 0.01
SURELY = 3.0  # sigmas
ASKED = ("rotation_deg", "translation_m", "time_shift_s")  # a calibration fits where all of these are seen to

WAVE = "carry it by hand, tilt it up and down, turn it left and right and roll it for half a minute, in good light"


@dataclass(frozen=True, slots=True, eq=False)
class Quantity:
    """One part of a calibration: what is asked of it, in units of its own."""

    name: str
    key: str  # in the results
    unit: tuple[str, float]  # that people are told, and how many of it are one of the results'
    away: FloatArray  # what was found less what was told
    sigma: FloatArray
    known_to: float  # a standard deviation beyond which the recording does not tell it
    borne: float  # a difference that needs no repair
    excited: str  # why the motion does not show it; empty where it does

    @property
    def is_observable(self) -> bool:
        return not self.excited and bool((self.sigma <= self.known_to).all())

    @property
    def in_sigmas(self) -> FloatArray:
        return np.asarray(self.away / self.sigma)

    @property
    def fits(self) -> bool:
        """Whether it is near enough to what was told, or as far away as chance would have it."""
        is_near = float(np.linalg.norm(self.away)) <= self.borne
        return is_near or bool((np.abs(self.in_sigmas) <= SURELY).all())

    @property
    def is_surely_wrong(self) -> bool:
        """Also where it is known too little to be repaired."""
        return not self.excited and not self.fits

    @property
    def sentence(self) -> str:
        if self.excited:
            return f"the {self.name} is not observable here: {self.excited}"
        size, give_or_take = self._told(float(np.linalg.norm(self.away))), self._told(float(self.sigma.max()))
        if not self.is_observable:
            said = f", although surely off, by about {size}" if self.is_surely_wrong else ""
            return f"the {self.name} is not observable here: known to ± {give_or_take} only{said}"
        said = "fits" if self.fits else "does not fit"
        return f"the {self.name} {said}: found {size} ± {give_or_take} from what was told"

    def _told(self, value: float) -> str:
        """To two digits, as a person writes it."""
        name, many = self.unit
        shown = value * many
        digits = max(0, 1 - floor(log10(abs(shown)))) if shown else 0
        return f"{shown:.{digits}f}{name}"


def sentences(found: list[Quantity]) -> list[str]:
    """What is seen of each; what several are not seen by for one and the same reason is said of them together."""
    hidden = dict.fromkeys(quantity.excited for quantity in found if quantity.excited)
    together = []
    for why in hidden:
        names = [f"the {quantity.name}" for quantity in found if quantity.excited == why]
        together.append(f"{' and '.join(names)} {'is' if len(names) == 1 else 'are'} not observable here: {why}")
    return [*together, *(quantity.sentence for quantity in found if not quantity.excited)]


def too_little(samples: Samples, num_images: int) -> list[str]:
    """Reasons against a recording before anything is estimated."""
    if num_images < 2:
        return ["the recording holds no images: record the camera as well"]
    seconds = float(np.ptp(samples.t_s))
    if seconds < MIN_DURATION_S:
        return [f"the recording lasts {seconds:.1f} s only: record half a minute"]
    rate = float(np.sqrt(((samples.gyro - np.median(samples.gyro, axis=0)) ** 2).sum(axis=1).mean()))
    if rate < MIN_RATE:
        return [f"it stood too still ({rate:.3f} rad/s), so that nothing is observable: {WAVE}"]
    silent_s = np.diff(samples.t_s)
    longest = int(silent_s.argmax())
    if silent_s[longest] > MAX_SILENCE_S:
        return [
            f"the IMU fell silent for {silent_s[longest]:.1f} s at second {samples.t_s[longest]:.0f}: see to its cable"
            " and to what else the robot computes, and record again"
        ]
    return []


def poor_turning(match: TurningMatch) -> list[str]:
    """Reasons against a motion in which nothing joins camera and IMU."""
    if match.rates[0] < MIN_RATE:
        return [f"it hardly turned ({match.rates[0]:.3f} rad/s), so that nothing is observable: {WAVE}"]
    if match.unexplained > MAX_UNEXPLAINED:
        return [
            "the IMU turned otherwise than the camera: fasten both to one rigid body, keep people and moving things out"
            " of the picture, and check that the time stamps are those of one clock"
        ]
    if abs(match.shift_s) > 0.98 * MAX_SHIFT_S:
        return [f"the clocks of camera and IMU differ by more than {MAX_SHIFT_S:g} s: correct the time stamps"]
    return []


def planar_scene(match: TurningMatch, planar: float) -> list[str]:
    """Why a lively camera and its IMU seem to contradict each other, where a plane explains that share of the corners.

    Empty where it does not, or where the motion itself is too little.
    """
    if planar <= MAX_PLANAR or match.rates[1] < MIN_SECOND_RATE:
        return []
    return [
        "all that the camera saw may lie in one plane, as a board on a wall does, which leaves open how it turned: look"
        f" into a furnished room instead, at things near and far; {WAVE}"
    ]


def poor_fit(solution: Solution, match: TurningMatch) -> list[str]:
    """Reasons against an estimate that does not explain the measurements."""
    if not solution.has_converged:
        return [f"the estimate did not settle: {_one_axis(match) or WAVE}"]
    reasons = []
    if solution.left_out > MAX_LEFT_OUT or solution.rms_px > MAX_PX:
        reasons.append(
            f"{100 * solution.left_out:.0f} % of the corners move otherwise than a still scene does, and"
            f" {solution.rms_px:.1f} px are left over: keep people and moving things out of the picture, and calibrate"
            " the camera if its focus changed"
        )
    scale = solution.problem.noise_scale
    assert scale is not None
    if scale.max() > MAX_NOISE_RATIO:
        reasons.append(
            f"the IMU is {scale.max():.0f} times as far from the camera's motion as its noise allows: fasten camera and"
            " IMU to one rigid body, or give the noise it really has"
        )
    camera = solution.estimate.camera
    if match.rates[1] >= MIN_SECOND_RATE:
        turned = np.degrees(np.linalg.norm(so3_log(match.R_body_cam.T @ camera.T_body_cam_matrix[:3, :3])))
        shifted = abs(camera.middle_row_shift_s - match.shift_s)
        if turned > MAX_TURNED_DEG or shifted > MAX_SHIFTED_S:
            reasons.append(
                f"two ways of estimating disagree by {turned:.1f} degrees and {1e3 * shifted:.0f} ms: {WAVE}"
            )
    return reasons


def quantities(solution: Solution, told: CameraCalibration, match: TurningMatch) -> list[Quantity]:
    """What was found of each part of the calibration."""
    camera = solution.estimate.camera
    T, T_told = camera.T_body_cam_matrix, told.T_body_cam_matrix
    one_axis = _one_axis(match)
    repeats = "the motion repeats itself" if match.runner_up < MIN_APART * match.unexplained else ""
    focal, focal_sigma = solution.focal_scale, solution.focal_sigma
    return [
        Quantity(
            "rotation", "rotation_deg", ("°", 1.0),
            np.degrees(so3_log(T_told[:3, :3].T @ T[:3, :3])), np.degrees(solution.sigma(MOUNT_ROTATION)),
            known_to=0.17, borne=0.5, excited=one_axis,
        ),
        Quantity(
            "position", "translation_m", (" mm", 1e3), T[:3, 3] - T_told[:3, 3], solution.sigma(MOUNT_POSITION),
            known_to=0.005, borne=0.015, excited=one_axis,
        ),
        Quantity(
            "time shift", "time_shift_s", (" ms", 1e3), np.array([camera.time_shift_s - told.time_shift_s]),
            solution.sigma(slice(SHIFT, SHIFT + 1)), known_to=3.3e-4, borne=1e-3, excited=repeats,
        ),
        Quantity(
            "line delay", "line_delay_s", (" µs", 1e6), np.array([camera.line_delay_s - told.line_delay_s]),
            solution.sigma(slice(DELAY, DELAY + 1)), known_to=2e-6, borne=2e-6, excited=repeats,
        ),
        Quantity(
            "focal length", "focal_length", (" %", 100.0), np.array([focal - 1.0]), np.array([focal_sigma]),
            known_to=0.015, borne=0.02, excited="",
        ),
    ]  # fmt: skip


def too_vague(found: list[Quantity]) -> list[str]:
    """Reasons against writing a calibration: neither of its main numbers is known, or one is wrong and stays so."""
    main = [quantity for quantity in found if quantity.key in ("rotation_deg", "time_shift_s")]
    vague = [quantity for quantity in main if not quantity.is_observable]
    if len(vague) == len(main):
        return [f"this motion tells neither {' nor '.join(quantity.name for quantity in main)} well enough: {WAVE}"]
    wrong = [quantity.name for quantity in found if quantity.is_surely_wrong and not quantity.is_observable]
    return [f"surely off, but known too little to be repaired: {' and '.join(wrong)}; {WAVE}"] if wrong else []


def _one_axis(match: TurningMatch) -> str:
    """What to do where it turned about one axis only; empty where it did not."""
    if match.rates[1] >= MIN_SECOND_RATE:
        return ""
    main = int(np.argmax(np.abs(match.axes_cam[0])))
    rest = " and ".join(turn for axis, turn in enumerate(TURNS) if axis != main)
    return (
        f"it turned about one axis only ({match.rates[1]:.2f} rad/s about any other); carry it by hand, {rest} as well"
    )
