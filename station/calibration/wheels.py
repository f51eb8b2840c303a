"""How far a robot's wheels really carry and turn it, from a minute of driving before a board of known size.

Between two rests the way is the integral of the command times a factor, however late the motors answer. So only
rests are compared: the camera sees the board before and after a straight drive, the gyroscope counts a turn. The
motors' lag then shows in how the yaw rate follows the command.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
from scipy.optimize import minimize_scalar
from scipy.special import stdtrit

from shared.calibration import CameraCalibration
from shared.errors import DataError
from shared.geometry import FloatArray, IntArray, inverse, orthonormal, se3
from station.calibration import CALIBRATE_CAMERA
from station.calibration.boards import make_finder, view_board
from station.calibration.layout import OTHER_BOARD, is_other_board
from station.calibration.target import BoardView, Target
from station.calibration.wheels_felt import felt_way
from station.datasets.dataset import Dataset
from station.model.frames import DriveSample, ImageFrame, ImuBatch
from station.motion.drive_commands import MIN_COMMAND, REST_AFTER_S, commands_motion
from station.vision.camera_pose import solve_pose_from
from station.vision.lens import Lens

MIN_REST_S = 0.3  # of standing still that a rest must last, after the motors have stopped
POSE_TOLERANCE_PX = 2.0
LEAST_VIEWS = 3  # of the board in a rest
LEAST_MOVES = 3  # of each sort: fewer cannot contradict each other
LEAST_WAY_M, LEAST_TURN_RAD = 0.1, 0.5  # of one move that is worth comparing
# Relative errors that all moves share, so that no scatter shows them. The way goes with the focal length, which a
# calibration file gives without its sigma: `station calibrate camera` accepts up to 1 %, half of it is assumed. It goes
# with the board's scale as well: a ruler tells 0.3 mm of the page's 100. The turn goes with the gyroscope's scale:
# the MPU-6050's data sheet allows 3 %, taken for three sigmas; nothing here measures it.
FOCAL_SIGMA, BOARD_SIGMA, GYRO_SIGMA = 0.005, 0.003, 0.01
WAY_SIGMA = math.hypot(FOCAL_SIGMA, BOARD_SIGMA)
# Likewise the way that the accelerometer tells goes with its scale, of which the data sheet allows 3 % as well.
FELT_SIGMA = math.hypot(WAY_SIGMA, 0.01)
SURELY = 3.0  # sigmas, by which the board's metre is another than the accelerometer's
MAX_SCATTER = 0.05  # between single moves; wheels that slip that much are stopped by something
MAX_SIGMA = 0.0225  # relative, of it 0.02 by scatter: floors differ by more
MIN_TURN_SAMPLES = 20
MAX_IMU_GAP_S = 0.05  # a turn that is longer without samples may have changed meanwhile
LAG_RANGE_S = (0.005, 0.5)
PERCENT_3_SIGMA = 0.99865  # of a normal distribution is below three sigmas
IMU_MISSING = "Samples of the IMU are missing"
TOO_FEW_RESTS = "The robot hardly stands still: record a minute, and pause two seconds between moves."
RECORD_AGAIN = "see that nothing else keeps the robot busy, and record again"


def is_drive(linear_m: float, largest_rad_s: float) -> bool:
    """Whether these commands are a straight way, far enough to compare."""
    return abs(linear_m) > LEAST_WAY_M and largest_rad_s < MIN_COMMAND


def is_turn(angular_rad: float, largest_m_s: float) -> bool:
    """Whether these commands are a turn on the spot, far enough to compare."""
    return abs(angular_rad) > LEAST_TURN_RAD and largest_m_s < MIN_COMMAND


@dataclass(frozen=True, slots=True)
class Move:
    """Commands between two rests: what was commanded and what came of it."""

    begin_ns: int
    end_ns: int
    linear_m: float  # integral of the commanded speeds
    angular_rad: float
    command_m_s: float  # the largest one
    command_rad_s: float
    went_m: float | None  # forward, as the board tells; None where it was not seen before and after
    turned_rad: float  # to the left, as the gyroscope tells

    @property
    def is_drive(self) -> bool:
        """Straight on or back, far enough to compare."""
        return is_drive(self.linear_m, self.command_rad_s)

    @property
    def is_turn(self) -> bool:
        """On the spot, far enough to compare."""
        return is_turn(self.angular_rad, self.command_m_s)


@dataclass(frozen=True, slots=True)
class Factor:
    """Achieved over commanded, from several moves."""

    value: float
    sigma: float  # as large as makes three of them hold in 99.7 %, however few moves there are
    scatter: float  # of a single move, relative
    moves: int


@dataclass(frozen=True, slots=True)
class Wheels:
    """What was measured; None where the recording does not tell."""

    speed: Factor | None  # forward
    turn: Factor | None
    lag_s: float | None  # of two equal lags one after the other, as motor and gear have it
    lag_sigma_s: float | None
    moves: tuple[Move, ...]
    reasons: tuple[str, ...]  # against using it, with the remedy

    @property
    def accepted(self) -> bool:
        return not self.reasons


def calibrate_wheels(data: Dataset, target: Target, on_frame: Callable[[], None] = lambda: None) -> Wheels:
    """Measure a robot's wheels. Raises DataError where the dataset lacks a sensor altogether."""
    camera = data.calibration.camera
    if data.imu is None or not len(data.imu):
        raise DataError(f"{data.path} has no IMU samples; record the robot with its IMU")
    if camera is None or data.read_frames is None:
        raise DataError(f"{data.path} has no images; record the robot with its camera")
    if not camera.is_measured:
        raise DataError(
            f"{data.path}: the lens is a guess; {CALIBRATE_CAMERA}, give the robot its camera.yaml, and record again"
        )
    if not data.drive:
        raise DataError(f"{data.path} has no drive commands; record a drive of the robot itself")
    t_ns = data.imu.t_robot_ns
    stops = find_rests(data.drive, int(t_ns[-1]))
    if len(stops) < 2:
        return Wheels(None, None, None, None, (), (TOO_FEW_RESTS,))
    rests = _felt(stops, t_ns)
    if len(rests) < 2:
        return Wheels(None, None, None, None, (), (f"{IMU_MISSING} almost everywhere: {RECORD_AGAIN}.",))
    views = board_views(data.read_frames(), camera, target, rests, on_frame)
    if is_other_board(target, [view for rest in views for view in rest]):
        return Wheels(None, None, None, None, (), (f"{OTHER_BOARD}.",))
    poses = [board_pose(rest, camera, target) for rest in views]
    yaw_rate = _yaw_rates(data.imu, rests)
    moves = _moves(data.drive, t_ns, yaw_rate, rests, poses)
    speed = fit_factor([(m.linear_m, m.went_m) for m in moves if m.went_m is not None and m.is_drive], WAY_SIGMA)
    turn = fit_factor([(m.angular_rad, m.turned_rad) for m in moves if m.is_turn], GYRO_SIGMA)
    lag, lag_sigma = (None, None) if turn is None else _fit_lag(data.drive, t_ns, yaw_rate, moves, turn.value)
    lost = len(stops) - 1 - len(moves)
    reasons = [*_reasons(moves, lost, poses, speed, turn), *_other_metre(felt_scale(data.imu, rests, moves))]
    return Wheels(speed, turn, lag, lag_sigma, moves, tuple(reasons))


# --- rests and moves --------------------------------------------------------------------------------------------------


def find_rests(drive: Sequence[DriveSample], end_ns: int) -> list[tuple[int, int]]:
    """Spans (begin, end) ns in which the robot stands still: no motion is commanded and the last one has died away."""
    times = [d.t_robot_ns for d in drive] + [end_ns]
    rests, since = list[tuple[int, int]](), None
    if not commands_motion(drive[0]):
        since = times[0]
    for before, after in zip(drive, [*drive[1:], None], strict=True):
        starts = after is None or commands_motion(after)
        until = end_ns if after is None else after.t_robot_ns
        if commands_motion(before):
            since = until + round(REST_AFTER_S * 1e9)
        elif starts and since is not None and until - since > MIN_REST_S * 1e9:
            rests.append((since, until))
    return rests


def _moves(
    drive: Sequence[DriveSample],
    imu_t_ns: IntArray,
    yaw_rate: FloatArray,
    rests: list[tuple[int, int]],
    poses: list[FloatArray | None],
) -> tuple[Move, ...]:
    """What happened between each rest and the next; not where the IMU was silent meanwhile."""
    told = Commands(drive)
    found = []
    for k, ((_, begin), (end, _)) in enumerate(pairwise(rests)):
        if _has_gap(imu_t_ns, begin, end):
            continue
        total, largest = told.between(begin, end)
        found.append(
            Move(
                begin,
                end,
                float(total[0]),
                float(total[1]),
                float(largest[0]),
                float(largest[1]),
                _forward(poses[k], poses[k + 1]),
                _integral(imu_t_ns, yaw_rate, begin, end),
            )
        )
    return tuple(found)


class Commands:
    """What the motors were told, each command until the next one."""

    def __init__(self, drive: Sequence[DriveSample]) -> None:
        self._t_ns = np.array([d.t_robot_ns for d in drive])
        self._told = np.array([[d.linear_m_s, d.angular_rad_s] for d in drive])

    def between(self, begin_ns: int, end_ns: int) -> tuple[FloatArray, FloatArray]:
        """Of the commands given from one time to another: their integral (m, rad) and the largest (m/s, rad/s)."""
        t_ns = self._t_ns
        held = slice(np.searchsorted(t_ns, begin_ns), np.searchsorted(t_ns, end_ns))
        until = np.append(t_ns[held][1:], min(end_ns, t_ns[held.stop] if held.stop < len(t_ns) else end_ns))
        total = (self._told[held] * ((until - t_ns[held]) * 1e-9)[:, None]).sum(axis=0)
        return total, np.abs(self._told[held]).max(axis=0)


def _felt(rests: list[tuple[int, int]], t_ns: IntArray) -> list[tuple[int, int]]:
    """The rests of which the IMU's samples, at times (N,) ns, tell its biases; from its first sample on."""
    begun = [(max(begin, int(t_ns[0])), end) for begin, end in rests]
    return [(begin, end) for begin, end in begun if end - begin > MIN_REST_S * 1e9 and not _has_gap(t_ns, begin, end)]


def _has_gap(t_ns: IntArray, begin: int, end: int) -> bool:
    """Whether samples at times (N,) ns leave more than MAX_IMU_GAP_S of a span open, at its ends or within."""
    inside = t_ns[slice(*np.searchsorted(t_ns, (begin, end)))]
    return bool(np.diff(inside, prepend=begin, append=end).max() > MAX_IMU_GAP_S * 1e9)


def _yaw_rates(imu: ImuBatch, rests: list[tuple[int, int]]) -> FloatArray:
    """Rates (N,) rad/s about the vertical, without the bias that the rests show."""
    inside = [slice(*np.searchsorted(imu.t_robot_ns, rest)) for rest in rests]
    middles = [0.5 * (begin + end) for begin, end in rests]
    biases = np.array([imu.gyro_imu[part].mean(axis=0) for part in inside])
    up = np.mean([imu.accel_imu[part].mean(axis=0) for part in inside], axis=0)
    up /= np.linalg.norm(up)
    return imu.gyro_imu @ up - np.interp(imu.t_robot_ns, middles, biases @ up)


def _integral(t_ns: IntArray, rate: FloatArray, begin: int, end: int) -> float:
    part = slice(np.searchsorted(t_ns, begin), np.searchsorted(t_ns, end))
    return float(np.trapezoid(rate[part], t_ns[part] * 1e-9))


def _forward(before: FloatArray | None, after: FloatArray | None) -> float | None:
    """The way (m) from one pose T_board_body (4, 4) to another, negative where it leads back."""
    if before is None or after is None:
        return None
    way = after[:3, 3] - before[:3, 3]
    return float(np.copysign(np.linalg.norm(way), way @ (before[:3, 0] + after[:3, 0])))


# --- where the robot stands in front of the board ---------------------------------------------------------------------


def board_views(
    frames: Iterator[ImageFrame],
    camera: CameraCalibration,
    target: Target,
    rests: list[tuple[int, int]],
    on_frame: Callable[[], None],
) -> list[list[BoardView]]:
    """What the pictures of each rest show of the board."""
    finder = make_finder(target)
    seen: list[list[BoardView]] = [[] for _ in rests]
    begins = np.array([begin for begin, _ in rests])
    for frame in frames:
        on_frame()
        t_ns = frame.t_robot_ns + round(camera.middle_row_shift_s * 1e9)
        rest = int(np.searchsorted(begins, t_ns)) - 1
        if rest < 0 or t_ns > rests[rest][1]:
            continue  # it may be moving
        try:
            grey = frame.grey()
        except DataError:
            continue  # damaged on its way
        view = view_board(finder, target, grey, frame.name, frame.t_robot_ns)
        if view is not None and view.ids_are_sure:
            seen[rest].append(view)
    return seen


def board_pose(views: list[BoardView], camera: CameraCalibration, target: Target) -> FloatArray | None:
    """T_board_body (4, 4) in a rest: the middle of its pictures; None where they hardly show the board."""
    lens, corners, poses = Lens(camera), target.corners, []
    for view in views:
        rays = lens.unproject(view.corners_px)
        T_board_cam = pose_before_board(corners[view.ids], rays, POSE_TOLERANCE_PX / camera.fx)
        if T_board_cam is not None:
            poses.append(T_board_cam @ camera.T_cam_body_matrix)
    return _middle(poses) if len(poses) >= LEAST_VIEWS else None


def pose_before_board(p_board: FloatArray, rays: FloatArray, tolerance: float) -> FloatArray | None:
    """T_board_cam (4, 4) from corners (n, 3) seen at (n, 2); None where they agree on none.

    From the plane's homography, not from three points as among landmarks: those of a plane that is parallel to the
    image tell no pose, and a board that somebody hung carefully is nearly so.
    """
    found, rotation, translation = cv2.solvePnP(p_board, rays, np.eye(3), np.zeros(4))
    if not found:
        return None
    R, t = (np.asarray(part, dtype=np.float64) for part in (cv2.Rodrigues(rotation)[0], translation))
    start = inverse(se3(R, t.ravel()))
    pose = solve_pose_from(start, p_board, rays, tolerance)
    return None if pose is None else pose.T_map_cam


def _middle(poses: list[FloatArray]) -> FloatArray:
    """The pose (4, 4) whose position is the median and whose rotation the mean one."""
    T = np.stack(poses)
    return se3(orthonormal(T[:, :3, :3].mean(axis=0)), np.median(T[:, :3, 3], axis=0))


# --- factors and lag --------------------------------------------------------------------------------------------------


def fit_factor(pairs: list[tuple[float, float]], shared_sigma: float) -> Factor | None:
    """Achieved over commanded, from pairs (commanded, achieved); None of fewer than LEAST_MOVES.

    Args:
        shared_sigma: relative, of what makes all of the achieved ones too long or too short alike.
    """
    if len(pairs) < LEAST_MOVES:
        return None
    commanded, achieved = np.array(pairs).T
    weight = commanded**2 / (commanded**2).sum()
    ratio = achieved / commanded
    value = float(weight @ ratio)
    scatter = float(np.sqrt(weight @ (ratio - value) ** 2 * len(pairs) / (len(pairs) - 1)) / abs(value))
    return Factor(
        value, float(np.hypot(_sigma_of_mean(scatter, len(pairs)), shared_sigma)) * abs(value), scatter, len(pairs)
    )


def felt_scale(imu: ImuBatch, rests: Sequence[tuple[int, int]], moves: Sequence[Move]) -> Factor | None:
    """Of the straight drives, the ways that the accelerometer tells over those that the board tells."""
    rest_before = {end: (begin, end) for begin, end in rests}
    drives = [(m, m.went_m) for m in moves if m.is_drive and m.went_m]
    if len(drives) < LEAST_MOVES:
        return None
    went = np.array([went_m for _, went_m in drives])
    felt = np.array([felt_way(imu, rest_before[m.begin_ns], m.begin_ns, m.end_ns) for m, _ in drives])
    # What noise leaves of a double integral grows with the time to 3/2.
    weight = went**2 / np.array([float(m.end_ns - m.begin_ns) for m, _ in drives]) ** 3
    weight /= weight.sum()
    value = float(weight @ (felt / went))
    # Drives that count little make up for few of those that count.
    count = 1.0 / float(weight @ weight)
    scatter = float(np.sqrt(weight @ (felt / went - value) ** 2 * len(drives) / (len(drives) - 1)))
    few = stdtrit(len(drives) - 1, PERCENT_3_SIGMA) / SURELY
    return Factor(value, math.hypot(few * scatter / math.sqrt(count), FELT_SIGMA * abs(value)), scatter, len(drives))


def _sigma_of_mean(scatter: float, count: int) -> float:
    """Of a mean, from the scatter of few values: Student's quantile in place of three sigmas."""
    few = stdtrit(count - 1, PERCENT_3_SIGMA) / 3.0
    return float(few * scatter / np.sqrt(count))


def _fit_lag(
    drive: Sequence[DriveSample], imu_t_ns: IntArray, yaw_rate: FloatArray, moves: Sequence[Move], factor: float
) -> tuple[float, float] | tuple[None, None]:
    """How late the motors answer, s, and its sigma: from each turn by itself."""
    t_ns = np.array([d.t_robot_ns for d in drive])
    turning = np.array([d.angular_rad_s for d in drive])
    commanded = factor * turning[np.maximum(np.searchsorted(t_ns, imu_t_ns, side="right") - 1, 0)]
    commanded[imu_t_ns < t_ns[0]] = 0.0
    lags = []
    for move in moves:
        part = slice(*np.searchsorted(imu_t_ns, (move.begin_ns, move.end_ns)))
        if part.stop - part.start < MIN_TURN_SAMPLES or not commanded[part].any():
            continue
        period_s = float(np.diff(imu_t_ns[part]).mean()) * 1e-9
        lags.append(_lag_of_turn(commanded[part], yaw_rate[part], period_s))
    if len(lags) < LEAST_MOVES:
        return None, None
    few = stdtrit(len(lags) - 1, PERCENT_3_SIGMA) / 3.0
    return float(np.mean(lags)), float(few * np.std(lags, ddof=1) / np.sqrt(len(lags)))


def _lag_of_turn(commanded: FloatArray, measured: FloatArray, period_s: float) -> float:
    """The lag (s) that explains measured rates (N,) best; a turn's own grip is free."""

    def misfit(lag_s: float) -> float:
        expected = late(commanded, lag_s, period_s)
        grip = (expected @ measured) / (expected @ expected)
        return float(((measured - grip * expected) ** 2).sum())

    return float(minimize_scalar(misfit, bounds=LAG_RANGE_S, method="bounded", options={"xatol": 1e-5}).x)


def late(commanded: FloatArray, lag_s: float, period_s: float) -> FloatArray:
    """What two equal first-order lags, one after the other, make of commands (N,) held from sample to sample."""
    from scipy.signal import lfilter  # brings all of scipy.stats: half a second that every start of workers is spared

    kept = np.exp(-period_s / lag_s)
    # Exact for a held input: state of both lags, x' = (u - x) / lag, y' = (x - y) / lag.
    k = kept * period_s / lag_s
    return np.asarray(lfilter([0.0, 1 - kept - k, kept * kept - kept + k], [1.0, -2 * kept, kept * kept], commanded))


# --- verdict ----------------------------------------------------------------------------------------------------------


def _other_metre(felt: Factor | None) -> list[str]:
    """Why the board's metre cannot be believed."""
    if felt is None or not abs(felt.value - 1.0) > SURELY * felt.sigma:
        return []
    return [
        f"By the accelerometer the robot went {felt.value:.2f} ± {felt.sigma:.2f} times as far as by the board:"
        " target.yaml is of another board or its tagSize is wrong, or the focal length is another camera's; measure a"
        " tag of the board and correct tagSize, or calibrate the camera."
    ]


def _reasons(
    moves: tuple[Move, ...], lost: int, poses: list[FloatArray | None], speed: Factor | None, turn: Factor | None
) -> list[str]:
    """What speaks against using it, each with what to do."""
    reasons = []
    if lost and (speed is None or turn is None):
        reasons.append(f"{IMU_MISSING} in {lost} of {lost + len(moves)} moves: {RECORD_AGAIN}.")
    if sum(m.is_drive for m in moves) < LEAST_MOVES:
        reasons.append("There are hardly any straight drives: drive to and fro before the board at several speeds.")
    elif speed is None:
        shown = sum(pose is not None for pose in poses)
        reasons.append(
            f"The board is seen in {shown} of {len(poses)} rests: keep it in view, in good light, before and after "
            "each straight drive, near enough to fill half of the image."
        )
    if turn is None:
        reasons.append("There are hardly any turns: turn on the spot, twice to each side, with a pause after each.")
    for name, factor in (("straight drives", speed), ("turns", turn)):
        if factor is None:
            continue
        if not np.isfinite([factor.value, factor.sigma]).all():
            reasons.append(f"The {name} cannot be compared with their commands: record them again.")
        elif not factor.scatter <= MAX_SCATTER:
            reasons.append(
                f"The {name} differ by {100 * factor.scatter:.0f} %: free the robot's way, and drive on one even floor."
            )
        elif not factor.sigma <= MAX_SIGMA * abs(factor.value):
            reasons.append(
                f"The {name} tell only to {100 * factor.sigma / abs(factor.value):.1f} %: make more and longer ones."
            )
        if factor.value <= 0:
            reasons.append(f"The {name} go the wrong way round: check the motors' wiring (`pi.invert_left`).")
    return reasons
