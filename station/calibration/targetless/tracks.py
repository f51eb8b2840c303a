"""What the camera saw of an ordinary scene: the part of a recording in which it turned most, and corners followed."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np

from shared.calibration import CameraCalibration
from shared.errors import DataError
from shared.geometry import FloatArray, IntArray, so3_exp
from station.calibration.camera_imu.rows import Samples
from station.model.frames import ImageFrame
from station.vision.klt import Tracker, TrackerConfig
from station.vision.lens import BoolArray, Lens
from station.vision.patches import Anchors, smoothed

MAX_USED_S = 30.0  # more takes longer than it tells
MAX_KEYFRAMES = 160  # the equations are dense in them
MIN_SIGHTINGS = 3  # of a corner: two views say nothing that a third could contradict
MAX_IMAGES = 20  # a track drifts: what goes on longer begins a corner of its own
MIN_TRACKED = 15  # corners from one image to the next: fewer do not tell how the camera turned
TRACKER = TrackerConfig(num_features=160, epipolar_px=2.0)


@dataclass(frozen=True, slots=True, eq=False)
class Sightings:
    """M sightings of L corners in K images, sorted by corner and, of one corner, by image."""

    t_s: FloatArray  # (K,) camera clock, of each image's first row
    image: IntArray  # (M,)
    corner: IntArray  # (M,) 0 .. L - 1, each seen in consecutive images
    uv_px: FloatArray  # (M, 2)
    xy: FloatArray  # (M, 2) normalised, by the lens that was told
    notes: tuple[str, ...] = ()  # what is to be said about images that could not be used

    @property
    def num_corners(self) -> int:
        return int(self.corner[-1]) + 1 if len(self.corner) else 0

    def chosen(self, which: BoolArray) -> Sightings:
        """Those of which `which` (M,) is true, of corners that are still seen often enough."""
        corner = self.corner[which]
        often = np.bincount(corner, minlength=self.num_corners) >= MIN_SIGHTINGS
        kept = np.flatnonzero(which)[often[corner]]
        _, renumbered = np.unique(self.corner[kept], return_inverse=True)
        return replace(self, image=self.image[kept], corner=renumbered, uv_px=self.uv_px[kept], xy=self.xy[kept])


def liveliest_part(samples: Samples) -> tuple[float, float]:
    """Begin and end, IMU clock, of the MAX_USED_S in which it turned most about all axes."""
    t_s, gyro = samples.t_s, samples.gyro
    dt = np.diff(t_s, append=t_s[-1])[:, None, None]
    after = np.searchsorted(t_s, t_s + MAX_USED_S, side="right")
    if after[0] == len(t_s):
        return float(t_s[0]), float(t_s[-1])
    summed = np.concatenate([np.zeros((1, 3, 3)), np.cumsum(gyro[:, :, None] * gyro[:, None] * dt, axis=0)])
    begin = int(np.argmax(np.linalg.det(summed[after] - summed[:-1])))
    return float(t_s[begin]), float(t_s[begin]) + MAX_USED_S


def follow(
    frames: Iterable[ImageFrame],
    camera: CameraCalibration,
    samples: Samples,
    origin_ns: int,
    num_frames: int,
    advance: Callable[[], None],
) -> Sightings:
    """Corners followed through all of the images; of these about MAX_KEYFRAMES are kept.

    The gyroscope, by the calibration that was told, only says where to look.
    Images that cannot be read are passed over; `Sightings.notes` says so.
    Raises:
        DataError: an image is not of the lens' size, or none can be read.
    """
    lens = Lens(camera)
    tracker, anchors = Tracker(lens, TRACKER), Anchors()
    step = max(1, -(-num_frames // MAX_KEYFRAMES))
    R_body_cam = camera.T_body_cam_matrix[:3, :3]
    angle = np.concatenate([np.zeros((1, 3)), np.cumsum(samples.gyro[:-1] * np.diff(samples.t_s)[:, None], axis=0)])
    times: list[float] = []
    images: list[IntArray] = []
    ids: list[IntArray] = []
    uv: list[FloatArray] = []
    unreadable: list[str] = []
    before_s = None
    for number, frame in enumerate(frames):
        advance()
        try:
            grey = frame.grey()
        except DataError as exc:
            unreadable.append(str(exc))
            continue
        if grey.shape != (camera.height, camera.width):
            raise DataError(
                f"image {frame.name or frame.index} has {grey.shape[1]}x{grey.shape[0]} pixels, the lens was calibrated"
                f" with {camera.width}x{camera.height}; give --calibration with the lens at that size"
            )
        t_s = 1e-9 * (frame.t_robot_ns - origin_ns)
        at = t_s + camera.middle_row_shift_s
        turned = (
            np.zeros(3) if before_s is None else _angle(at, samples.t_s, angle) - _angle(before_s, samples.t_s, angle)
        )
        before_s = at
        seen = tracker.process(grey, R_body_cam.T @ so3_exp(turned) @ R_body_cam, is_bias_known=False)
        if number % step:
            continue
        numbers, at_px = anchors.seen(smoothed(grey), seen.ids, seen.uv_px)
        images.append(np.full(len(numbers), len(times)))
        times.append(t_s)
        ids.append(numbers)
        uv.append(at_px)
    if not times:
        raise DataError(f"none of the images can be used{_first(unreadable)}; record the camera as well")
    uv_px = np.concatenate(uv)
    notes = (f"not used: {len(unreadable)} images cannot be read{_first(unreadable)}",) if unreadable else ()
    sightings = _sorted(np.array(times), np.concatenate(images), np.concatenate(ids), uv_px, lens.unproject(uv_px))
    return replace(sightings, notes=notes)


def _first(unreadable: list[str]) -> str:
    return f", the first: {unreadable[0]}" if unreadable else ""


def _angle(t_s: float, t_imu_s: FloatArray, angle: FloatArray) -> FloatArray:
    """(3,) rad: what the gyroscope's readings sum up to until then; of a few hundredths of a second, a rotation."""
    return np.array([np.interp(t_s, t_imu_s, axis) for axis in angle.T])


def _sorted(t_s: FloatArray, image: IntArray, ids: IntArray, uv_px: FloatArray, xy: FloatArray) -> Sightings:
    begun = np.full(int(ids.max(initial=0)) + 1, len(t_s))
    np.minimum.at(begun, ids.astype(np.int64), image.astype(np.int64))
    piece = (image - begun[ids.astype(np.int64)]) // MAX_IMAGES
    ids = ids * (len(t_s) + 1) + piece
    order = np.lexsort((image, ids))
    _, corner = np.unique(ids[order], return_inverse=True)
    every = Sightings(t_s, image[order].astype(np.int64), corner, uv_px[order], xy[order])
    return every.chosen(np.ones(len(order), dtype=bool))
