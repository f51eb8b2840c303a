"""The views of a target in a dataset, and why there are few where there are few."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from math import ceil

import cv2
import numpy as np

from shared.errors import DataError
from station.calibration.boards import AprilGridFinder, Finder, make_finder, view_board
from station.calibration.camera import Rejected
from station.calibration.dictionaries import charuco_markers
from station.calibration.layout import OTHER_BOARD
from station.calibration.target import BoardView, Target
from station.datasets import Dataset
from station.model.frames import ImageArray, ImageFrame

MAX_IMAGES = 300  # of a long recording, that many evenly over it
BLURRED_PX = 2.5  # sigma of edges in an image of up to 1000 px, from which on their places are doubtful
MOVED = 2.5  # times the blur of the sharper images
DARK = 30.0  # mean grey level
LEAST_WHOLE = 3  # images with all of a chessboard, without which parts of one may be of another board
NO_BOARD = "no board was found"
EXAMPLES = 8  # images without a board that are looked at again to say why


@dataclass(frozen=True, slots=True, eq=False)
class Views:
    """What the images of a dataset show of a target."""

    views: tuple[BoardView, ...]
    size: tuple[int, int]  # width and height of the images, px
    rejected: tuple[Rejected, ...]
    looked_at: int
    missed: tuple[ImageArray, ...]  # some of the images in which no whole board was found


def find_views(target: Target, data: Dataset, advance: Callable[[], None] = lambda: None) -> Views:
    """Look for the target in the images of a dataset. Raises DataError where it has none."""
    if data.read_frames is None:
        raise DataError(f"{data.path} holds no camera images; choose a dataset with images")
    step = ceil(len(data.frame_times_ns) / MAX_IMAGES)
    finder, found = make_finder(target), _Found()
    for frame in data.read_frames():
        if frame.index % step == 0:
            found.add(frame, target, finder)
        advance()
    return found.views()


def blur_limit_px(size: tuple[int, int]) -> float:
    """Sigma of the blur from which on an image is not used."""
    return BLURRED_PX * max(1.0, max(size) / 1000.0)


class _Found:
    """Collects what is seen, image by image."""

    def __init__(self) -> None:
        self._views: list[tuple[BoardView, tuple[int, int]]] = []
        self._rejected: list[Rejected] = []
        self._missed: list[ImageArray] = []
        self._sizes: Counter[tuple[int, int]] = Counter()
        self._count = 0

    def add(self, frame: ImageFrame, target: Target, finder: Finder) -> None:
        name = frame.name or f"frame {frame.index}"
        self._count += 1
        try:
            grey = frame.grey()
        except DataError as exc:
            self._rejected.append(Rejected(name, "unreadable", f"cannot be read: {exc}"))
            return
        size = (grey.shape[1], grey.shape[0])
        self._sizes[size] += 1
        view = view_board(finder, target, grey, name, frame.t_robot_ns)
        if view is not None:
            self._views.append((view, size))
        else:
            self._rejected.append(Rejected(name, "no board", NO_BOARD))
        is_whole = view is not None and view.ids_are_sure  # a part alone may be of another board
        if not is_whole and len(self._missed) < EXAMPLES:
            self._missed.append(grey)

    def views(self) -> Views:
        size = self._sizes.most_common(1)[0][0] if self._sizes else (0, 0)
        for view, other in self._views:
            if other != size:
                self._rejected.append(
                    Rejected(view.name, "size", f"is {other[0]}x{other[1]}, most others are {size[0]}x{size[1]}")
                )
        fitting = [view for view, other in self._views if other == size]
        if sum(view.ids_are_sure for view in fitting) < LEAST_WHOLE:
            self._rejected += [Rejected(v.name, "no board", NO_BOARD) for v in fitting if not v.ids_are_sure]
            fitting = [view for view in fitting if view.ids_are_sure]
        sharp, blurred = _sharp(fitting, size)
        return Views(tuple(sharp), size, (*self._rejected, *blurred), self._count, tuple(self._missed))


def _sharp(views: list[BoardView], size: tuple[int, int]) -> tuple[list[BoardView], list[Rejected]]:
    """The views whose edges are sharp enough, and those that moved or are out of focus."""
    if not views:
        return [], []
    usual = float(np.percentile([view.blur_px for view in views], 25))
    limit = min(blur_limit_px(size), MOVED * max(usual, 0.8))
    blurred = [
        Rejected(
            view.name,
            "blurred",
            f"blurred over {view.blur_px:.1f} px: the board or the camera moved, or it is out of focus",
        )
        for view in views
        if view.blur_px > limit
    ]
    return [view for view in views if view.blur_px <= limit], blurred


def why_few(target: Target, seen: Views, used: int, least: int, rejected: tuple[Rejected, ...]) -> str:
    """One sentence: why fewer images than needed can be used, and what to do."""
    so_few = f"{used} of {seen.looked_at} images can be used, {least} are needed"
    causes = Counter(item.cause for item in rejected)
    usual = max(causes, key=lambda cause: causes[cause], default=None)
    if usual == "blurred":
        return f"{so_few}: most are blurred; turn the focus ring until the board is sharp, and hold it still"
    if usual == "repeated":
        return f"{so_few}: the board stayed in one place; move it over the whole image, near and far, and tilt it"
    if usual == "disagrees":
        return f"{so_few}: they disagree with each other; see that board and lens are fixed, and hold the board still"
    if usual == "other board":
        return OTHER_BOARD
    if usual == "no board":
        return f"{so_few}: {_why_missed(target, seen)}"
    return f"{so_few}; take 20 to 40, with the board at other places, distances and tilts"


def _why_missed(target: Target, seen: Views) -> str:
    """What is wrong with images in which no board was found."""
    if float(np.median([image.mean() for image in seen.missed])) < DARK:
        return "the images are too dark; take more light or a longer exposure"
    if float(np.median([image_blur_px(image) for image in seen.missed])) > blur_limit_px(seen.size):
        return "the images are out of focus; turn the focus ring until the board is sharp"
    if target.kind != "chessboard" and any(_is_mirrored(target, image) for image in seen.missed):
        return "they are mirrored, as a selfie camera's; switch mirroring off (one hflip or vflip alone mirrors, too)"
    return other_board(target, seen) or (
        f"{_name(target)} is not found; see that target.yaml describes the board (of a chessboard it counts inner "
        "corners), bring it nearer, and light it evenly"
    )


def other_board(target: Target, seen: Views) -> str:
    """What the images in which the target was not found show instead, if that is most of all; empty where nothing."""
    if 2 * sum(item.cause == "no board" for item in seen.rejected) <= seen.looked_at:
        return ""
    other = next(filter(None, (_other_target(target, image) for image in seen.missed)), "")
    return other and (
        f"they show {other}, target.yaml describes {_name(target)}; give the file of the board that was used"
    )


def image_blur_px(grey: ImageArray) -> float:
    """Sigma of the blur of an image's sharpest edges, px.

    A Gaussian edge of sigma s that is blurred by another 2 px loses its slope as s / sqrt(s^2 + 4). Both are first
    blurred by 1 px, against noise.
    """
    slopes = []
    for sigma in (1.0, np.sqrt(5.0)):
        smooth = cv2.GaussianBlur(grey.astype(np.float32), (0, 0), sigma)
        slope = np.hypot(cv2.Sobel(smooth, cv2.CV_32F, 1, 0), cv2.Sobel(smooth, cv2.CV_32F, 0, 1))
        slopes.append(float(np.percentile(slope, 99.5)))
    ratio = min(slopes[1] / max(slopes[0], 1e-6), 0.999) ** 2
    return float(np.sqrt(max(5.0 * ratio - 1.0, 0.0) / (1.0 - ratio)))


def _is_mirrored(target: Target, image: ImageArray) -> bool:
    """Tags say it; a chessboard has the same look in a mirror."""
    return make_finder(target).find(np.ascontiguousarray(image[:, ::-1])) is not None


def _other_target(target: Target, image: ImageArray) -> str:
    """A target of another kind or size that an image shows; empty where none is seen."""
    if target.kind != "aprilgrid":
        grid = AprilGridFinder(Target("aprilgrid", 20, 20, 0.03, gap_m=0.009))
        if len(grid.find_tags(image)) >= 4:
            return "an AprilGrid"
    markers = charuco_markers(image)
    if markers and markers != target.dictionary.rpartition("_")[0]:
        return f"markers of {markers}"
    for columns, rows in _other_sizes(target):
        other = replace(target, kind="chessboard", columns=columns, rows=rows)
        board = make_finder(other).find(image)
        if board is not None and board.ids_are_sure:
            are_squares = (columns + 1, rows + 1) == (target.columns, target.rows)
            squares = " (the file has to count those, not the squares)" if are_squares else ""
            return f"a chessboard of {columns} x {rows} inner corners{squares}"
    return ""


def _other_sizes(target: Target) -> list[tuple[int, int]]:
    """Sizes of chessboards that are confused with this target's, and usual ones."""
    c, r = target.columns, target.rows
    near = [(c - 1, r - 1), (c + 1, r + 1), (c - 1, r), (c, r - 1), (c + 1, r), (c, r + 1)]
    near = [] if target.kind == "aprilgrid" else near
    usual = [(9, 6), (8, 6), (7, 6), (8, 5), (7, 5), (11, 8), (10, 7), (7, 7), (8, 8), (9, 7), (7, 4), (5, 4)]
    same = {(c, r), (r, c)} if target.kind == "chessboard" else set()
    sizes = [size for size in dict.fromkeys(near + usual) if min(size) >= 3 and size not in same]
    return sorted(sizes, key=lambda size: -size[0] * size[1])  # a part of a board may look like a smaller one


def _name(target: Target) -> str:
    what = {"aprilgrid": "an AprilGrid", "charuco": "a ChArUco board", "chessboard": "a chessboard"}[target.kind]
    unit = "tags" if target.kind == "aprilgrid" else "inner corners"
    return f"{what} of {target.columns} x {target.rows} {unit}"
