"""Where walls stand on the floor, as pictures show it: bare ones, too, of which nobody has landmarks.

Across the line in which a wall meets the floor a picture shows a step of brightness. On the floor it is in one place
from wherever one looks, and always from dark to bright or always the contrary; steps of what stands above the floor
fall onto other places of it from elsewhere, and cancel (sweeping a plane: Collins, CVPR 1996). Planks, tiles and rugs
stay in place as well, but behind their lines there is more floor: its pattern is in one place, what a picture shows of
a wall is not.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np
import numpy.typing as npt
from scipy import ndimage

from shared.calibration import CameraCalibration
from shared.geometry import FloatArray, IntArray
from station.model.frames import ImageArray, decode_picture
from station.model.navigation import Navigation
from station.places.making.scale import units_per_metre
from station.places.rooms.lengths import FLOOR_PERCENT
from station.places.rooms.surfaces import LINE_M, PIECE_M, SIDES, Side, Surfaces
from station.vision.lens import Lens

MOST_PICTURES = 800  # of a longer drive every second one, or every third
FARTHEST_M = 4.0  # from a camera: farther, a plane is no pixel from the next
IN_FRONT_M = 0.3  # of a plane: nearer, a camera looks along it
NEAREST_M = 0.3  # to a camera, along its axis
BLUR_PX = 1.5
STEP_PX = 2.0  # from a line up and down: of what a step is the difference
DARK = 10.0  # of 255: steps of darker pictures are noise
FLOOR_WITHIN_M, FLOOR_BIN_M, FLOOR_BINS = 0.05, 0.001, 9  # 1 % of a height is 3 cm of the way to a wall 3 m away
LEAST_ABOVE_M = 0.1  # the floor's pattern is seen from a height
RUN = 5  # pieces beside each other that are judged together: a wall's foot is longer than a stain
LEAST_LOOKS = 10  # at a run
PEAK_PLANES = 5  # of which the one with the largest step may be a wall
SURE = (0, 2, 4, 6, 8)  # least of each class: a step, in standard deviations of what cancels
BEYOND = range(2, 7)  # planes
STILL = (0.0, 0.2, 0.5)  # least of each class: share of what is seen beyond that stays in place
UNSEEN = 0
FOOT_CLASSES = 1 + 2 * len(SURE) * len(STILL)


@dataclass(frozen=True, slots=True, eq=False)
class Steps:
    """Of the steps of brightness that pictures show on each piece of each plane, (planes, pieces) each."""

    total: FloatArray
    squares: FloatArray
    count: FloatArray

    @classmethod
    def none(cls, shape: tuple[int, ...]) -> Steps:
        return cls(np.zeros(shape), np.zeros(shape), np.zeros(shape))

    def add(self, plane: IntArray, piece: IntArray, step: FloatArray) -> None:
        """At most one step for each piece."""
        self.total[plane, piece] += step
        self.squares[plane, piece] += step * step
        self.count[plane, piece] += 1


def with_feet(surfaces: Surfaces, navigation: Navigation, R_ground_map: FloatArray) -> Surfaces:
    """With what pictures show of the feet of walls; as it is where nobody knows the floor."""
    floor = floor_height(navigation, R_ground_map) if navigation.is_gravity_aligned else None
    if floor is None or navigation.calibration.camera is None:
        return surfaces
    steps = {side: Steps.none(classes.shape) for side, classes in surfaces.classes.items()}
    for picture in _pictures(navigation, navigation.calibration.camera, R_ground_map):
        for axis in (0, 1):
            _add_steps(steps, picture, surfaces.low, axis, floor)
    return replace(surfaces, feet={side: foot_classes(steps[side], side) for side in SIDES})


def floor_height(navigation: Navigation, R_ground_map: FloatArray) -> float | None:
    """Metres: where the most of the lowest landmarks are as high; None where cameras are no higher."""
    unit = units_per_metre(navigation)
    z = navigation.landmarks.p_world @ R_ground_map[2] / unit
    eyes = navigation.keyframes.T_world_cam[:, :3, 3] @ R_ground_map[2] / unit
    z, eyes = z[np.isfinite(z)], eyes[np.isfinite(eyes)]
    if not len(z) or not len(eyes):
        return None
    about = float(np.percentile(z, FLOOR_PERCENT))
    edges = np.arange(about - FLOOR_WITHIN_M, about + FLOOR_WITHIN_M, FLOOR_BIN_M)
    count = ndimage.uniform_filter1d(np.histogram(z, edges)[0].astype(np.float64), FLOOR_BINS, mode="constant")
    most = float(edges[int(count.argmax())]) + 0.5 * FLOOR_BIN_M
    near = z[np.abs(z - most) < FLOOR_BINS * FLOOR_BIN_M]
    if not len(near):
        return None
    floor = float(np.median(near))
    return floor if np.median(eyes) > floor + LEAST_ABOVE_M else None


def foot_classes(steps: Steps, side: Side) -> npt.NDArray[np.intp]:
    """(planes, pieces) of the foot of a wall seen from that side: how sure its step is, and what is seen beyond."""
    total, squares, count = (_along(values) for values in (steps.total, steps.squares, steps.count))
    mean = np.abs(total) / np.maximum(count, 1.0)
    sure = np.abs(total) / np.sqrt(np.maximum(squares, 1e-9))
    is_peak = mean >= ndimage.maximum_filter1d(mean, PEAK_PLANES, axis=0)
    beyond = [np.roll(_along(steps.total**2), side[1] * k, axis=0) for k in BEYOND]
    its_squares, its_count = (sum(np.roll(values, side[1] * k, axis=0) for k in BEYOND) for values in (squares, count))
    looks = its_count / (RUN * len(BEYOND))  # of each piece, in the mean
    still = sum(beyond) / np.maximum(its_squares, 1e-9) / np.maximum(looks, 1.0)
    of_still = np.where(RUN * looks < LEAST_LOOKS, 0, _class(still, STILL))
    classes = 1 + (is_peak * len(SURE) + _class(sure, SURE)) * len(STILL) + of_still
    return np.asarray(np.where(count < LEAST_LOOKS, UNSEEN, classes), dtype=np.intp)


def _along(values: FloatArray) -> FloatArray:
    """(planes, pieces) sums of a run around each piece."""
    return np.asarray(RUN * ndimage.uniform_filter1d(values, RUN, axis=1, mode="constant"))


def _class(values: FloatArray, least: tuple[float, ...]) -> npt.NDArray[np.intp]:
    return np.searchsorted(np.array(least), values, side="right") - 1


@dataclass(frozen=True, slots=True, eq=False)
class _Picture:
    """A keyframe's picture above the ground. Lengths are metres."""

    grey: ImageArray  # (H, W), blurred
    lens: Lens
    border: FloatArray  # (n, 3) rays in the camera's frame, around all that it shows
    eye: FloatArray  # (3,)
    R_ground_cam: FloatArray  # (3, 3)

    def extent(self) -> tuple[FloatArray, FloatArray]:
        """(2,) least and largest position on the ground that it may show."""
        ahead = (self.border @ self.R_ground_cam.T)[:, :2]
        ahead *= FARTHEST_M / np.maximum(np.linalg.norm(ahead, axis=1, keepdims=True), 1e-9)
        p = self.eye[:2] + np.concatenate([np.zeros((1, 2)), ahead])
        return p.min(axis=0), p.max(axis=0)

    def pixels(self, p: FloatArray) -> tuple[IntArray, IntArray]:
        """Which of the points (n, 3) it may show, (m,) indices, and where: (m, 2) pixels."""
        d = p - self.eye
        p_cam = d @ self.R_ground_cam
        widest = np.abs(self.border[:, :2]).max(axis=0)
        index = np.flatnonzero(
            (p_cam[:, 2] > NEAREST_M)
            & (np.hypot(d[:, 0], d[:, 1]) < FARTHEST_M)
            & (np.abs(p_cam[:, :2]) <= widest * p_cam[:, 2:]).all(axis=1)
        )
        uv = np.round(self.lens.project(p_cam[index, :2] / p_cam[index, 2:]))
        inside = self.lens.is_inside(uv, STEP_PX + 1.0)
        return index[inside], uv[inside].astype(np.int64)

    def steps(self, uv: IntArray) -> FloatArray:
        """(n,) at pixels (n, 2): by how much it is brighter below than above, of both."""
        down = -self.R_ground_cam[2, :2]
        du, dv = np.round(STEP_PX * down / max(float(np.hypot(*down)), 1e-9)).astype(np.int64)
        below = self.grey[uv[:, 1] + dv, uv[:, 0] + du].astype(np.float64)
        above = self.grey[uv[:, 1] - dv, uv[:, 0] - du].astype(np.float64)
        return np.asarray((below - above) / (below + above + DARK))


def _pictures(navigation: Navigation, camera: CameraCalibration, R_ground_map: FloatArray) -> Iterator[_Picture]:
    """Of keyframes all over the drive; those that nobody can read are left out."""
    keyframes, lens, unit = navigation.keyframes, Lens(camera), units_per_metre(navigation)
    right, bottom = camera.width - 1.0, camera.height - 1.0
    border_px = np.array([[u, v] for u in (0.0, 0.5 * right, right) for v in (0.0, 0.5 * bottom, bottom)])
    border = np.column_stack([lens.unproject(border_px), np.ones(len(border_px))])
    for k in range(0, len(keyframes), max(-(-len(keyframes) // MOST_PICTURES), 1)):
        T = keyframes.T_world_cam[k]
        try:
            grey = decode_picture(keyframes.encoded[k], cv2.IMREAD_GRAYSCALE)
        except ValueError:
            continue
        if grey.shape == (camera.height, camera.width) and np.isfinite(T).all():
            blurred = np.asarray(cv2.GaussianBlur(grey, (0, 0), BLUR_PX), dtype=np.uint8)
            yield _Picture(blurred, lens, border, R_ground_map @ T[:3, 3] / unit, R_ground_map @ T[:3, :3])


def _add_steps(steps: dict[Side, Steps], picture: _Picture, low: FloatArray, axis: int, floor: float) -> None:
    """What a picture shows of the planes across one axis."""
    begin, end = picture.extent()
    planes, pieces = steps[axis, 1].count.shape
    grid = np.meshgrid(
        _between((begin - low)[axis] / LINE_M, (end - low)[axis] / LINE_M, planes),
        _between((begin - low)[1 - axis] / PIECE_M - 0.5, (end - low)[1 - axis] / PIECE_M - 0.5, pieces),
        indexing="ij",
    )
    plane, piece = (numbers.ravel() for numbers in grid)
    p = np.empty((len(plane), 3))
    p[:, axis] = low[axis] + LINE_M * plane
    p[:, 1 - axis] = low[1 - axis] + PIECE_M * (piece + 0.5)
    p[:, 2] = floor
    index, uv = picture.pixels(p)
    step, away = picture.steps(uv), p[index, axis] - picture.eye[axis]
    for sign in (1, -1):
        its = sign * away < -IN_FRONT_M
        steps[axis, sign].add(plane[index[its]], piece[index[its]], step[its])


def _between(begin: float, end: float, count: int) -> IntArray:
    """The whole numbers in there, of those from 0 to less than `count`."""
    return np.arange(max(int(np.ceil(begin)), 0), min(int(np.floor(end)) + 1, count))
