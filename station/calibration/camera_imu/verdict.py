"""Whether a recording can tell how camera and IMU sit on each other, and whether what was found fits it.

Each refusal says what to do. How well the motion shows the mounting is asked of the motion itself: where it hardly
turned, or about one axis only, noise looks like motion and a covariance claims a hundredth of a degree where 100 are
wrong.
"""

from __future__ import annotations

import numpy as np

from station.calibration import CALIBRATE_CAMERA
from station.calibration.camera_imu.batch import Solution, TargetShape
from station.calibration.camera_imu.rows import Samples
from station.calibration.camera_imu.start import MAX_SHIFT_S, CameraPoses, TurningMatch
from station.calibration.camera_imu.unknowns import MOUNT_POSITION, MOUNT_ROTATION, SHIFT, intrinsics_of
from station.calibration.target import Target

MIN_DURATION_S = 10.0
MIN_VIEWS = 40
MIN_SHARE_SEEN = 0.4  # of the images
MAX_SILENCE_S = 0.5  # of the IMU: up to then the images show the motion
MIN_RATE = 0.1  # rad/s RMS about the axis that it turned second most about
MAX_UNEXPLAINED = 0.3  # of the turning's variance
MIN_APART = 3.0  # by how much worse the second best time shift must be
MAX_CORNER_PX = 1.4  # RMS of distances, 1 px in each direction: of sharp, well found corners it is 0.15 to 0.6
MAX_LEFT_OUT = 0.2  # of the corners, as of those of a camera's lens
MAX_NOISE_RATIO = 6.0  # of IMU residuals to the noise that was told: data sheets are off by up to three times
MAX_MOMENT = 3.0  # of the residuals' usual size, for half a second: of a rigid pair before a still target 1.5 to 1.8
SURELY = 5.0  # sigmas
MAX_SCALE_ERROR = 0.01
MAX_BEND_M = 1.5e-3
MAX_SIGMA = {"rotation": np.radians(0.3), "translation": 0.01, "time shift": 1e-3}
INTRINSIC_NAMES = ("fx", "fy", "cx", "cy", *(f"distortion coefficient {i}" for i in (1, 2, 3, 4)))
TURNS = ("tilt it up and down", "turn it left and right", "roll it about the direction of view")


def poor_views(poses: CameraPoses, num_images: int) -> list[str]:
    """Reasons against a recording that shows too little of the target."""
    seen = len(poses.t_s)
    if seen == 0 or seen < MIN_SHARE_SEEN * num_images:
        return [
            f"the target was found in {seen} of {num_images} images only: more light, a sharp lens, go nearer, and keep"
            " the whole target in view"
        ]
    seconds = float(np.ptp(poses.t_s))
    if seconds < MIN_DURATION_S:
        return [f"the target is in view for {seconds:.0f} s only: record 30 to 60 s"]
    if seen < MIN_VIEWS:
        return [
            f"{seen} images of the target in {seconds:.0f} s are too few to follow the motion, which takes {MIN_VIEWS}:"
            " record longer, or at more images a second"
        ]
    return []


def poor_imu(poses: CameraPoses, samples: Samples) -> list[str]:
    """Reasons against an IMU whose readings are interrupted while the target is in view."""
    silent_s = np.diff(samples.t_s)
    silent_s[(samples.t_s[1:] < poses.t_s[0]) | (samples.t_s[:-1] > poses.t_s[-1])] = 0.0
    longest = int(silent_s.argmax())
    if silent_s[longest] <= MAX_SILENCE_S:
        return []
    return [
        f"the IMU fell silent for {silent_s[longest]:.1f} s at second {samples.t_s[longest]:.0f}: see to its cable and"
        " to what else the robot computes, and record again"
    ]


def poor_motion(match: TurningMatch) -> list[str]:
    """Reasons against a motion that leaves the mounting or the time shift open."""
    first, second, _ = match.rates
    if first < MIN_RATE:
        return [f"it hardly turned ({first:.2f} rad/s): wave it faster, about all axes"]
    if second < MIN_RATE:
        main = int(np.argmax(np.abs(match.axes_cam[0])))
        rest = " and ".join(turn for axis, turn in enumerate(TURNS) if axis != main)
        return [f"it turned about one axis only ({second:.2f} rad/s about any other): {rest} as well"]
    if match.unexplained > MAX_UNEXPLAINED:
        return [
            "the IMU turned otherwise than the camera: fasten both to one rigid body, keep the target where it is, and"
            " check that the time stamps are those of one clock"
        ]
    if abs(match.shift_s) > 0.98 * MAX_SHIFT_S:
        return [f"the clocks of camera and IMU differ by more than {MAX_SHIFT_S:g} s: correct the time stamps"]
    if match.runner_up < MIN_APART * match.unexplained:
        return ["the motion repeats itself, so that several time shifts fit: move less regularly"]
    return []


def poor_fit(solution: Solution, told: Samples) -> list[str]:
    """Reasons against an estimate that does not explain the measurements; `told` holds the IMU's noise as told."""
    reasons = []
    if not solution.has_converged:
        reasons.append("the estimate did not settle: record again, slower, with the target in view all the time")
    if solution.rms_px > MAX_CORNER_PX:
        reasons.append(
            f"the corners lie {solution.rms_px:.1f} px (RMS) beside where they should: focus the lens, calibrate"
            " the camera first, and use the target whose file was given"
        )
    if solution.left_out > MAX_LEFT_OUT:
        reasons.append(
            f"{100 * solution.left_out:.0f} % of the corners lie far beside where they should: take more light, cover"
            " what mirrors in the target, and use the target whose file was given"
        )
    ratios = {
        "gyroscope": solution.fit.gyro / told.sigma_gyro,
        "accelerometer": solution.fit.accel / told.sigma_accel,
    }
    for sensor, ratio in ratios.items():
        if ratio > MAX_NOISE_RATIO:
            reasons.append(
                f"the {sensor} is {ratio:.1f} times as far from the camera's motion as its noise allows: keep the"
                " target where it is, fasten camera and IMU to one rigid body, or give the noise it really has"
            )
    when, ratio = solution.worst_moment
    if ratio > MAX_MOMENT:
        reasons.append(
            f"at second {when:.0f} the camera's motion is {ratio:.0f} times as far from the IMU's as otherwise: the"
            " target moved, or the camera on its mount; fasten both and record again"
        )
    for name, sigma in known_to(solution).items():
        if sigma > MAX_SIGMA[name]:
            reasons.append(f"the {name} stays uncertain: record longer, and turn faster about all axes")
    return reasons


def poor_lens(solution: Solution) -> list[str]:
    """Reasons against a lens that is not the one it was said to be: it may be refined, not replaced."""
    problem, found = solution.problem, intrinsics_of(solution.unknowns.camera)
    told, sigma = intrinsics_of(problem.known.camera), problem.known.sigma_intrinsics
    away = np.divide(np.abs(found - told), sigma, out=np.zeros_like(sigma), where=sigma > 0)
    worst = int(away.argmax())
    if away[worst] <= SURELY:
        return []
    return [
        f"the lens is another than its file says: {INTRINSIC_NAMES[worst]} is {found[worst]:.4g}, not {told[worst]:.4g}"
        f"; {CALIBRATE_CAMERA} with the lens as it is focused now, and give its file as --camera"
    ]


def known_to(solution: Solution) -> dict[str, float]:
    """Largest standard deviation of each quantity: rad, m, s."""
    return {
        "rotation": float(solution.sigma(MOUNT_ROTATION).max()),
        "translation": float(solution.sigma(MOUNT_POSITION).max()),
        "time shift": float(solution.sigma(slice(SHIFT, SHIFT + 1))[0]),
    }


def is_another(shape: TargetShape) -> bool:
    """Whether a target seems not to be as its file says, surely or not."""
    return abs(shape.scale - 1.0) > MAX_SCALE_ERROR or bool((np.abs(shape.bend_m) > MAX_BEND_M).any())


def poor_target(shape: TargetShape, target: Target) -> list[str]:
    """Reasons against a target that is not as its file says: the accelerometer knows metres."""
    reasons = []
    if abs(shape.scale - 1.0) > max(MAX_SCALE_ERROR, SURELY * shape.sigma_scale):
        true_mm, told_mm = 1e3 * shape.scale * target.square_m, 1e3 * target.square_m
        reasons.append(
            f"the target is {shape.scale:.3f} times as large as its file says: its squares measure {true_mm:.1f} mm,"
            f" not {told_mm:.1f} mm; measure one, correct the file, or print it unscaled"
        )
    bend = np.abs(shape.bend_m)
    if ((bend > MAX_BEND_M) & (bend > SURELY * shape.sigma_bend_m)).any():
        reasons.append(f"the target is bent by {1e3 * bend.max():.0f} mm: fix it to something flat and stiff")
    return reasons
