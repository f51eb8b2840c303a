"""What depth adds to a navigation, whichever backend made it: the scans themselves, and metres where it has none."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from shared.calibration import DepthCalibration
from shared.errors import DataError
from shared.geometry import FloatArray, IntArray, carry_poses, inverse, sim3, transform
from station.model.frames import DepthArray, DepthFrame
from station.model.navigation import DepthScans, Navigation, Trajectory
from station.motion.interpolation import scan_poses
from station.slam.mapping.pose_alignment import METRIC_SIGMA, ScaleEstimate

MAX_SIDE = 64  # pixels of a stored scan: at 2 m one every 4 cm, as wide as a wall's piece needs
MAX_SCANS = 2000  # 12 MB; beyond, every second one is left out, of those to come too
BESIDE_NS = 1_000_000_000  # a keyframe so near in time sees what the sensor sees
MIN_LANDMARKS = 10  # of one scan, for its median
MIN_SCANS = 3  # that say the scale, for their spread
SMOOTH = 1.1  # of four neighbouring pixels the farthest by the nearest: beyond, an edge lies between them
# Structured light and time of flight are a per cent off in the middle of their range (Khoshelham and Elberink,
# Sensors 12(2), 2012), alike on all pictures.
SYSTEMATIC = 0.01
ROUNDS = 6  # the sensor's place beside the camera is metric: where a landmark lies in its picture depends on the scale


class DepthLog:
    """Takes the depth pictures of a navigation in; keeps fewer of their pixels, and not more than so many."""

    def __init__(self) -> None:
        self._sensor: DepthCalibration | None = None
        self._times: list[int] = []
        self._pictures: list[DepthArray] = []
        self._every = self._waits = 1  # of so many pictures one is kept; until the next one

    def add(self, frame: DepthFrame) -> None:
        """In time order. Raises DataError when it cannot be decoded, or another sensor took it.

        Of a cone nobody knows where in it the thing is: it says nothing of walls, nor of single landmarks.
        """
        if frame.sensor.is_cone:
            return
        if self._sensor not in (None, frame.sensor):
            raise DataError(f"depth picture {frame.name or frame.t_robot_ns} is of another sensor than those before it")
        self._sensor = frame.sensor
        if self._times and frame.t_robot_ns <= self._times[-1]:
            return
        self._waits -= 1
        if self._waits > 0:
            return
        step = step_of(frame.sensor)
        first = (step - 1) // 2
        self._pictures.append(frame.millimetres()[first::step, first::step].copy())
        self._times.append(frame.t_robot_ns)
        if len(self._times) > MAX_SCANS:
            self._times, self._pictures, self._every = self._times[::2], self._pictures[::2], 2 * self._every
        self._waits = self._every

    def scans(self) -> DepthScans | None:
        if self._sensor is None or not self._times:
            return None
        thinned = self._sensor.thinned(step_of(self._sensor))
        return DepthScans(np.array(self._times, dtype=np.int64), np.stack(self._pictures), thinned)


def step_of(sensor: DepthCalibration) -> int:
    """Of how many pixels one is kept, across and down."""
    return -(-max(sensor.width, sensor.height) // MAX_SIDE)


def with_depth(navigation: Navigation, log: DepthLog) -> Navigation:
    """The navigation with what the depth sensor measured, in metres where the backend knew none.

    A map that has its metre from inertial readings or wheels keeps it; the report says what depth makes of it. Without
    a depth picture it is the same navigation.
    """
    scans = log.scans()
    if scans is None:
        return navigation
    navigation = replace(navigation, depth=scans)
    if len(np.unique(navigation.keyframes.segment)) > 1 and not navigation.is_metric:
        return _reported(navigation, {}, "depth gives no metres: the pieces of this map have a scale each")
    found = scale_from_depth(navigation, scans)
    if found is None:
        return _reported(navigation, {}, "depth says nothing of the scale: it shows too few landmarks")
    facts = {"scale": found.scale, "sigma": found.sigma_relative}
    if navigation.is_metric:
        off = abs(np.log(found.scale)) > 3 * found.sigma_relative
        return _reported(navigation, facts, f"by depth, lengths are {found.scale:.3f} times as long" if off else "")
    if found.sigma_relative > METRIC_SIGMA:
        sentence = f"depth gives no metres: its pictures differ by {100 * found.sigma_relative:.0f} %"
        return _reported(navigation, facts, sentence)
    sentence = f"metres by depth, to {100 * found.sigma_relative:.1f} %"
    return _reported(_scaled(navigation, found.scale), facts, sentence)


def scale_from_depth(navigation: Navigation, scans: DepthScans) -> ScaleEstimate | None:
    """Metres per unit: measured depth by the depth of landmarks, the median of the scans' medians.

    The scans' spread is not divided by their number: what they differ by is mostly the map's own bending, which is the
    same in all scans of one part. None where too few scans show landmarks.
    """
    scale, sits_in_body = 1.0, True  # at first as if the sensor sat in the body's origin: that needs no scale
    for _ in range(ROUNDS):
        ratios = [m.log_ratios for m in measured_landmarks(navigation, scans, scale, sits_in_body=sits_in_body)]
        medians = np.array([np.median(r) for r in ratios if len(r) >= MIN_LANDMARKS])
        if len(medians) < MIN_SCANS:
            return None
        scale *= float(np.exp(np.median(medians)))
        sits_in_body = False
    spread = 1.4826 * float(np.median(np.abs(medians - np.median(medians))))
    return ScaleEstimate(scale, float(np.hypot(spread, SYSTEMATIC)), "depth")


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredLandmarks:
    """Landmarks whose depth one scan measured."""

    scan: int
    landmark: IntArray  # (n,)
    p_depth: FloatArray  # (n, 3) m, the sensor's coordinates: where the map has them
    measured_m: FloatArray  # (n,) along the sensor's axis

    @property
    def log_ratios(self) -> FloatArray:
        """(n,) of measured depth by the map's."""
        return np.log(self.measured_m / self.p_depth[:, 2])


def measured_landmarks(
    navigation: Navigation, scans: DepthScans, scale: float, *, sits_in_body: bool = False
) -> Iterator[MeasuredLandmarks]:
    """For each scan whose pose is known what it measured of the landmarks that keyframes see then.

    Args:
        scale: metres per unit of the map.
        sits_in_body: as if the sensor's centre were the body's.
    """
    T_world_body, kept = scan_poses(navigation.trajectory, scans)
    T_depth_body = inverse(scans.sensor.T_body_depth_matrix)
    offset = np.zeros(3) if sits_in_body else T_depth_body[:3, 3]
    beside = _landmarks_beside(navigation, scans.t_robot_ns[kept])
    for T, k, landmark in zip(T_world_body, kept.tolist(), beside, strict=True):
        p_body = transform(inverse(T), navigation.landmarks.p_world[landmark])
        p_depth = scale * p_body @ T_depth_body[:3, :3].T + offset
        rows, measured_m = _look_up(p_depth, scans.millimetres[k], scans.sensor)
        yield MeasuredLandmarks(k, landmark[rows], p_depth[rows], measured_m)


def _landmarks_beside(navigation: Navigation, t_ns: IntArray) -> list[IntArray]:
    """For each time the landmarks that the keyframes before and after it observe."""
    keyframes, landmarks = navigation.keyframes, navigation.landmarks
    by_keyframe = landmarks.observations_by_keyframe(len(keyframes))
    camera = navigation.calibration.camera
    t_keyframes = keyframes.t_robot_ns + (0 if camera is None else round(1e9 * camera.time_shift_s))
    out = []
    for t in t_ns.tolist():
        after = int(np.searchsorted(t_keyframes, t))
        near = [k for k in (after - 1, after) if 0 <= k < len(keyframes) and abs(int(t_keyframes[k]) - t) <= BESIDE_NS]
        rows = np.concatenate([np.empty(0, np.int64), *(by_keyframe[k] for k in near)])
        out.append(np.unique(landmarks.observed_landmark[rows]))
    return out


def _look_up(p_depth: FloatArray, millimetres: DepthArray, sensor: DepthCalibration) -> tuple[IntArray, FloatArray]:
    """Which of the points (n, 3), in the sensor's coordinates, lie where it measured a smooth surface; and its depth
    there, m, between four pixels.
    """
    height, width = millimetres.shape
    rows = np.flatnonzero(p_depth[:, 2] > 0)
    p = p_depth[rows]
    u, v = sensor.fx * p[:, 0] / p[:, 2] + sensor.cx, sensor.fy * p[:, 1] / p[:, 2] + sensor.cy
    inside = (u >= 0) & (v >= 0) & (u < width - 1) & (v < height - 1)
    rows, u, v = rows[inside], u[inside], v[inside]
    i, j = v.astype(np.int64), u.astype(np.int64)
    corners = np.stack([millimetres[i + a, j + b] for a in (0, 1) for b in (0, 1)]) * 1e-3
    is_smooth = (corners.min(axis=0) > 0) & (corners.max(axis=0) <= SMOOTH * corners.min(axis=0))
    down, right = v - i, u - j
    weight = np.stack([(1 - down) * (1 - right), (1 - down) * right, down * (1 - right), down * right])
    return rows[is_smooth], (weight * corners).sum(axis=0)[is_smooth]


def _scaled(navigation: Navigation, scale: float) -> Navigation:
    S = sim3(scale, np.eye(3), np.zeros(3))
    keyframes, trajectory = navigation.keyframes, navigation.trajectory
    return replace(
        navigation,
        trajectory=Trajectory(trajectory.t_robot_ns, carry_poses(S, trajectory.T_world_body)),
        keyframes=replace(keyframes, T_world_cam=carry_poses(S, keyframes.T_world_cam)),
        landmarks=navigation.landmarks.moved(S),
        report=replace(navigation.report, scale="metric"),
    )


def _reported(navigation: Navigation, facts: dict[str, Any], sentence: str) -> Navigation:
    report = navigation.report
    scans = 0 if navigation.depth is None else len(navigation.depth)
    return replace(
        navigation,
        report=replace(
            report,
            config=report.config | {"depth": {"scans": scans} | facts},
            messages=(*report.messages, *((sentence,) if sentence else ())),
        ),
    )
