"""Feature tracks: new corners, then pyramidal Lucas-Kanade from where the gyroscope says a feature has moved."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from shared.geometry import FloatArray, IntArray, homogeneous
from station.model.frames import ImageArray
from station.vision.lens import BoolArray, Lens
from station.vision.two_view import epipolar_inliers

PointsArray = npt.NDArray[np.float32]  # (N, 1, 2), OpenCV's shape of points
MIN_FOLLOWED = 5  # features: the motion between two images has so many degrees of freedom that they show
LK_EPSILON_PX = 0.02  # the last step; half of it would take half as much time again, for what no filter can see
SUBPIX_WINDOW = (4, 4)
SUBPIX_CRITERIA = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 10, 0.02)


@dataclass(frozen=True, slots=True)
class TrackerConfig:
    """Front end's settings; pixels refer to the image as delivered."""

    num_features: int = 150
    cell_px: int = 32  # one new corner per empty cell of this size
    min_response: float = 3e-4  # Shi-Tomasi eigenvalue below which a corner is noise
    window_px: int = 17  # Lucas-Kanade
    pyramid_levels: int = 3  # reach: about window * 2^levels pixels around the prediction
    forward_backward_px: float = 0.7
    epipolar_px: float = 1.2  # with a known gyro bias
    epipolar_unbiased_px: float = 4.0  # before: 0.08 rad/s of unknown bias turn 2 px per frame
    border_px: int = 4
    redetect_below: float = 0.9  # new corners once fewer than this share of num_features live


@dataclass(frozen=True, slots=True, eq=False)
class TrackedFrame:
    """The features of one frame; track ids never repeat."""

    ids: IntArray  # (N,)
    uv_px: FloatArray  # (N, 2) as measured, distorted
    xy: FloatArray  # (N, 2) normalised, undistorted
    num_tracked: int  # of the previous frame's features, how many were found again
    brightness: float  # mean grey value of the image


class Tracker:
    """Keeps about num_features tracks alive. Deterministic for a seed."""

    def __init__(self, lens: Lens, config: TrackerConfig, seed: int = 0) -> None:
        self.lens = lens
        self.config = config
        self._seed = seed
        self._num_frames = 0
        self._next_id = 0
        self._previous: ImageArray | None = None
        self._ids = np.zeros(0, dtype=np.int64)
        self._uv = np.zeros((0, 2))
        self._xy = np.zeros((0, 2))

    def reset(self) -> None:
        """Forget all tracks; ids go on."""
        self._previous = None
        self._ids, self._uv, self._xy = np.zeros(0, dtype=np.int64), np.zeros((0, 2)), np.zeros((0, 2))

    def drop(self, ids: IntArray) -> None:
        """Forget these tracks: the filter found them to be outliers."""
        keep = ~np.isin(self._ids, ids)
        self._ids, self._uv, self._xy = self._ids[keep], self._uv[keep], self._xy[keep]

    @property
    def image(self) -> ImageArray | None:
        """The newest image (H, W)."""
        return self._previous

    def follow(self, uv_px: FloatArray, xy: FloatArray) -> IntArray:
        """Follow these places (N, 2) of the newest image, too; their new ids (N,)."""
        ids = np.arange(self._next_id, self._next_id + len(uv_px), dtype=np.int64)
        self._next_id += len(uv_px)
        self._ids = np.concatenate([self._ids, ids])
        self._uv, self._xy = np.concatenate([self._uv, uv_px]), np.concatenate([self._xy, xy])
        return ids

    def process(self, grey: ImageArray, R_prev_cur: FloatArray, is_bias_known: bool) -> TrackedFrame:
        """Follow the tracks into this image and add new ones.

        Args:
            grey: (H, W) 8 bit.
            R_prev_cur: (3, 3) rotation of the camera since the previous image (maps current to previous coordinates).
            is_bias_known: whether that rotation is free of the gyroscope's bias.
        """
        rng = np.random.default_rng([self._seed, self._num_frames])
        self._num_frames += 1
        if self._previous is not None and len(self._ids):
            self._follow(self._previous, grey, R_prev_cur, is_bias_known, rng)
        num_tracked = len(self._ids)
        if num_tracked < self.config.redetect_below * self.config.num_features:
            self._add_corners(grey)
        self._previous = grey
        return TrackedFrame(
            ids=self._ids.copy(),
            uv_px=self._uv.copy(),
            xy=self._xy.copy(),
            num_tracked=num_tracked,
            brightness=float(grey.mean()),
        )

    def _follow(
        self,
        previous: ImageArray,
        grey: ImageArray,
        R_prev_cur: FloatArray,
        is_bias_known: bool,
        rng: np.random.Generator,
    ) -> None:
        """Move every track into the new image or end it."""
        config = self.config
        predicted_xy, in_front = self._rotate(self._xy, R_prev_cur.T)
        predicted_uv = np.where(in_front[:, None], self.lens.project(predicted_xy), self._uv)
        old = self._uv.astype(np.float32).reshape(-1, 1, 2)
        new, found = _flow(
            previous,
            grey,
            old,
            predicted_uv.astype(np.float32).reshape(-1, 1, 2),
            config,
            config.pyramid_levels,
            LK_EPSILON_PX,
        )
        # Starts at its goal: needs no reach; and only whether it stays near is asked.
        back, found_back = _flow(grey, previous, new, old, config, 1, 0.1 * config.forward_backward_px)
        distance = np.linalg.norm((back - old).reshape(-1, 2), axis=1)
        uv = np.asarray(new, dtype=np.float64).reshape(-1, 2)
        good = found & found_back & (distance < config.forward_backward_px) & np.isfinite(uv).all(axis=1)
        good &= self.lens.is_inside(np.where(good[:, None], uv, -1e3), config.border_px)
        index = np.flatnonzero(good)
        near = predicted_xy[index] + (uv[index] - predicted_uv[index]) / self.lens.focal
        xy = self.lens.unproject(uv[index], near if in_front[index].all() else None)
        threshold_px = config.epipolar_px if is_bias_known else config.epipolar_unbiased_px
        inlier = epipolar_inliers(self._xy[index], xy, R_prev_cur, threshold_px / self.lens.camera.fx, rng)
        inlier &= self.lens.is_invertible(uv[index], xy)
        index, xy = index[inlier], xy[inlier]
        self._ids, self._uv, self._xy = self._ids[index], uv[index], xy

    def _rotate(self, xy: FloatArray, R: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Normalised coordinates after a rotation, and which of them stay well in front of the camera."""
        rays = homogeneous(xy) @ R.T
        in_front = rays[:, 2] > 0.2
        return rays[:, :2] / np.where(in_front, rays[:, 2], 1.0)[:, None], in_front

    def _add_corners(self, grey: ImageArray) -> None:
        corners = detect_corners(
            grey, self._uv, self.config.num_features - len(self._ids), self.config.cell_px, self.config.min_response
        )
        xy = self.lens.unproject(corners)
        usable = self.lens.is_invertible(corners, xy)
        self.follow(corners[usable], xy[usable])


def _flow(
    a: ImageArray,
    b: ImageArray,
    points: PointsArray,
    start: PointsArray,
    config: TrackerConfig,
    levels: int,
    epsilon_px: float,
) -> tuple[PointsArray, BoolArray]:
    """Lucas-Kanade from image a to b, starting at `start`."""
    moved, status, _ = cv2.calcOpticalFlowPyrLK(
        a, b, points, start.copy(),
        winSize=(config.window_px, config.window_px),
        maxLevel=levels,
        criteria=(cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 30, epsilon_px),
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
        minEigThreshold=1e-4,
    )  # fmt: skip
    return np.asarray(moved, dtype=np.float32), np.asarray(status).reshape(-1) == 1


def detect_corners(
    grey: ImageArray | npt.NDArray[np.floating[Any]],
    existing_px: FloatArray,
    wanted: int,
    cell_px: int,
    min_response: float,
    border_px: int = 12,
    peak_px: int = 0,
) -> FloatArray:
    """The strongest Shi-Tomasi corner of each empty cell, best first, refined to sub-pixel.

    Responses are computed at half resolution: a sixth of the time, and the sub-pixel step restores the position.
    Args:
        grey: (H, W) in whole levels or of 0 to 1.
        existing_px: (N, 2) pixels of live tracks; cells within half a cell of one of them stay empty.
        wanted: at most that many corners.
        min_response: smallest eigenvalue that counts, in OpenCV's units on a grey image in [0, 1].
        peak_px: so far around a corner none is stronger, and it is left at a pixel; 0: it may lie on the slope of one
            in the next cell, and the sub-pixel step moves it.
    Returns:
        (M, 2) pixels, M <= wanted.
    """
    if wanted <= 0:
        return np.zeros((0, 2))
    half = np.asarray(cv2.resize(grey, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA))
    response = np.asarray(cv2.cornerMinEigenVal(half, 3, ksize=3), dtype=np.float32)
    if peak_px:
        side = 2 * (peak_px // 2) + 1
        response[response < cv2.dilate(response, np.ones((side, side), np.uint8))] = 0.0
    border = border_px // 2
    response[:border] = response[-border:] = 0.0
    response[:, :border] = response[:, -border:] = 0.0
    for u, v in np.rint(existing_px * 0.5 - 0.25).astype(int).tolist():
        cv2.circle(response, (u, v), cell_px // 4, 0.0, -1)

    cell = cell_px // 2
    rows, cols = half.shape[0] // cell, half.shape[1] // cell
    blocks = response[: rows * cell, : cols * cell].reshape(rows, cell, cols, cell)
    cells = blocks.swapaxes(1, 2).reshape(rows * cols, cell * cell)
    best = np.argmax(cells, axis=1)
    strength = cells[np.arange(rows * cols), best]
    row, col = np.divmod(np.arange(rows * cols), cols)
    corners = np.stack([col * cell + best % cell, row * cell + best // cell], axis=1).astype(np.float64)
    order = np.argsort(-strength, kind="stable")
    order = order[strength[order] > min_response]
    corners = _spread(corners[order], cell_px / 4.0, wanted)
    if not len(corners):
        return np.zeros((0, 2))
    if peak_px:
        return corners * 2.0 + 0.5
    start = (corners * 2.0 + 0.5).astype(np.float32).reshape(-1, 1, 2)
    refined = cv2.cornerSubPix(grey, start, SUBPIX_WINDOW, (-1, -1), SUBPIX_CRITERIA)
    return np.asarray(refined, dtype=np.float64).reshape(-1, 2)


def _spread(points: FloatArray, min_distance: float, wanted: int) -> FloatArray:
    """The first `wanted` of the points (N, 2), best first, that are no nearer than min_distance to a better one."""
    kept = np.empty((min(wanted, len(points)), 2))
    count = 0
    for point in points:
        off = kept[:count] - point
        if count and float((off * off).sum(axis=1).min()) < min_distance * min_distance:
            continue
        kept[count] = point
        count += 1
        if count == wanted:
            break
    return kept[:count]
