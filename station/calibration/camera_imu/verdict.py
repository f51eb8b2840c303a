"""Whether a recording can tell how camera and IMU sit on each other, and whether what was found fits it.

Each refusal says what to do. How well the motion shows the mounting is asked of the motion itself: where it hardly
turned, or about one axis only, noise looks like motion and a covariance claims a hundredth of a degree where 100 are
wrong.
"""

from __future__ import annotations

import numpy as np

from shared.geometry import FloatArray
from station.calibration.camera_imu.batch import Solution
from station.calibration.camera_imu.start import MAX_SHIFT_S, CameraPoses, TurningMatch
from station.calibration.camera_imu.unknowns import BEND, MOUNT_POSITION, MOUNT_ROTATION, SCALE, SHIFT
from station.calibration.target import Target

MIN_DURATION_S = 10.0
MIN_VIEWS = 40
MIN_SHARE_SEEN = 0.4  # of the images
MIN_RATE = 0.1  # rad/s RMS about the axis that it turned second most about
MAX_UNEXPLAINED = 0.3  # of the turning's variance
MIN_APART = 3.0  # by how much worse the second best time shift must be
MAX_CORNER_PX = 1.0  # of a sharp, well found corner it is 0.1 to 0.4
MAX_NOISE_RATIO = 3.0  # of IMU residuals to the noise that was told: waving is noisier than a bench
SURELY = 5.0  # sigmas
MAX_SCALE_ERROR = 0.01
MAX_BEND_M = 1.5e-3
MAX_SIGMA = {"rotation": np.radians(0.3), "translation": 0.01, "time shift": 1e-3}
TURNS = ("tilt it up and down", "turn it left and right", "roll it about the direction of view")


def poor_views(poses: CameraPoses, num_images: int) -> list[str]:
    """Reasons against a recording that shows too little of the target."""
    seen = len(poses.t_s)
    if seen and seen >= MIN_SHARE_SEEN * num_images and np.ptp(poses.t_s) < MIN_DURATION_S:
        return [f"the target is in view for {np.ptp(poses.t_s):.0f} s only: record 30 to 60 s"]
    if seen < max(MIN_VIEWS, MIN_SHARE_SEEN * num_images):
        return [
            f"the target was found in {seen} of {num_images} images only: more light, a sharp lens, go nearer, and keep"
            " the whole target in view"
        ]
    return []


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


def poor_fit(solution: Solution, told_gyro: float, told_accel: float) -> list[str]:
    """Reasons against an estimate that does not explain the measurements.

    Args:
        told_gyro, told_accel: standard deviations of one sample that the IMU's noise means, rad/s and m/s^2.
    """
    reasons = []
    if not solution.has_converged:
        reasons.append("the estimate did not settle: record again, slower, with the target in view all the time")
    if solution.fit.corner_px > MAX_CORNER_PX:
        reasons.append(
            f"the corners lie {solution.fit.corner_px:.1f} px (RMS) beside where they should: focus the lens, calibrate"
            " the camera first, and use the target whose file was given"
        )
    ratios = {"gyroscope": solution.fit.gyro / told_gyro, "accelerometer": solution.fit.accel / told_accel}
    for sensor, ratio in ratios.items():
        if ratio > MAX_NOISE_RATIO:
            reasons.append(
                f"the {sensor} is {ratio:.1f} times as far from the camera's motion as its noise allows: keep the"
                " target where it is, fasten camera and IMU to one rigid body, or give the noise it really has"
            )
    for name, sigma in known_to(solution).items():
        if sigma > MAX_SIGMA[name]:
            reasons.append(f"the {name} stays uncertain: record longer, and turn faster about all axes")
    return reasons


def known_to(solution: Solution) -> dict[str, float]:
    """Largest standard deviation of each quantity: rad, m, s."""
    return {
        "rotation": float(solution.sigma(MOUNT_ROTATION).max()),
        "translation": float(solution.sigma(MOUNT_POSITION).max()),
        "time shift": float(solution.sigma(slice(SHIFT, SHIFT + 1))[0]),
    }


def poor_target(free: Solution, target: Target) -> list[str]:
    """Reasons against a target that is not as its file says, from an estimate that left its size and flatness open.

    The accelerometer knows metres, so it knows how large the target really is.
    """
    reasons = []
    scale, sigma = free.unknowns.scale, float(free.sigma(slice(SCALE, SCALE + 1))[0])
    if abs(scale - 1.0) > max(MAX_SCALE_ERROR, SURELY * sigma):
        true_mm, told_mm = 1e3 * scale * target.square_m, 1e3 * target.square_m
        reasons.append(
            f"the target is {scale:.3f} times as large as its file says: its squares measure {true_mm:.1f} mm, not"
            f" {told_mm:.1f} mm; measure one, correct the file, or print it unscaled"
        )
    bend, sigmas = np.abs(free.unknowns.bend), free.sigma(BEND)
    if is_bent(bend, sigmas):
        reasons.append(f"the target is bent by {1e3 * bend.max():.0f} mm: fix it to something flat and stiff")
    return reasons


def is_bent(bend: FloatArray, sigma: FloatArray) -> bool:
    return bool(((bend > MAX_BEND_M) & (bend > SURELY * sigma)).any())
