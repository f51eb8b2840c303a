"""Finds a calibration target in an image: all of it or a part, with corners to a fraction of a pixel."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import cv2
import numpy as np

from shared.geometry import FloatArray, IntArray
from station.calibration.dictionaries import APRIL_BITS, APRIL_BORDER_BITS, april_dictionary, charuco_board
from station.calibration.target import BoardView, Target
from station.model.frames import ImageArray
from station.vision.lens import BoolArray

SEARCH_SIDE_PX = 1280  # larger images are searched at a smaller size; their corners are refined at full size
LEAST_CORNERS = 8  # fewer say nothing that is not also in their noise
LEAST_CONTRAST = 12.0  # grey levels between black and white of a corner
MODULES = APRIL_BITS + 2 * APRIL_BORDER_BITS
SMOOTH_PX = 0.7  # off the smooth surface through its neighbours, from which on a corner is a wrong one
OUTLIER = 5.0  # of the median error
ALTERNATING = 0.95  # of the pairs of neighbouring squares; a row that is left out of 9 x 6 spoils a sixth
LIKENESS = 0.6  # correlation of a tag's modules with what is printed, from which on it is that tag


@dataclass(frozen=True, slots=True, eq=False)
class Board:
    """What an image shows of a target, before anybody judges it."""

    ids: IntArray  # (m,) rows of Target.corners
    corners_px: FloatArray  # (m, 2)
    ids_are_sure: bool = True


class Finder(Protocol):
    """Finds one kind of target in images."""

    def find(self, grey: ImageArray) -> Board | None: ...


def make_finder(target: Target) -> Finder:
    """The finder for a kind of target."""
    if target.kind == "aprilgrid":
        return AprilGridFinder(target)
    return CharucoFinder(target) if target.kind == "charuco" else ChessboardFinder(target)


def view_board(finder: Finder, target: Target, grey: ImageArray, name: str, t_robot_ns: int) -> BoardView | None:
    """The target's corners in an image; None where fewer than LEAST_CORNERS are there."""
    board = finder.find(grey)
    if board is None or len(board.ids) < LEAST_CORNERS:
        return None
    smooth = is_smooth(target, board)
    order = np.flatnonzero(smooth)[np.argsort(board.ids[smooth])]
    ids, corners_px = board.ids[order], board.corners_px[order]
    if len(ids) < LEAST_CORNERS:
        return None
    blur = blur_px(grey, target, ids, corners_px)
    return BoardView(name, t_robot_ns, ids, corners_px, blur, board.ids_are_sure)


def is_smooth(target: Target, board: Board) -> BoolArray:
    """Which corners (m,) lie where the others say: a flat board through any lens is a homography and a smooth rest.

    The rest is a polynomial of third degree over the board. What was refined onto something else stands out of it.
    """
    p_board = target.corners[board.ids, :2]
    A = surface_powers(p_board)
    is_good = np.ones(len(board.ids), dtype=bool)
    if len(board.ids) < 2 * A.shape[1]:
        return is_good
    H = homography(p_board, board.corners_px, cv2.LMEDS)
    if H is None:
        return ~is_good
    rest = board.corners_px - cv2.perspectiveTransform(p_board[None], H)[0]
    for _ in range(4):
        error = np.linalg.norm(rest - A @ np.linalg.lstsq(A[is_good], rest[is_good], rcond=None)[0], axis=1)
        is_good = error < max(SMOOTH_PX, OUTLIER * float(np.median(error[is_good])))
    return is_good


def surface_powers(p_board: FloatArray) -> FloatArray:
    """Of a polynomial of third degree over the board, at corners (n, 2): (n, 10)."""
    centred = (p_board - p_board.mean(axis=0)) / np.ptp(p_board, axis=0).max()
    x, y = centred.T
    return np.stack([x**i * y**j for i in range(4) for j in range(4 - i)], axis=1)


def homography(p_board: FloatArray, uv_px: FloatArray, method: int = 0) -> FloatArray | None:
    """(3, 3) from the board's plane (n, 2) to pixels (n, 2); None where the points do not say it."""
    H, _ = cv2.findHomography(p_board, uv_px, method)
    return np.asarray(H, dtype=np.float64) if np.size(H) == 9 else None


def refine(grey: ImageArray, corners_px: FloatArray, reach_px: float) -> FloatArray:
    """Corners (n, 2) where black and white fields meet, to a fraction of a pixel.

    Args:
        corners_px: (n, 2) where they are to within reach_px.
        reach_px: half the side of the square that is looked at; nothing else may be in it.
    """
    half = int(np.clip(reach_px, 2, 12))
    points = np.ascontiguousarray(corners_px.reshape(-1, 1, 2), dtype=np.float32)
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 30, 0.003)
    refined = cv2.cornerSubPix(grey, points, (half, half), (-1, -1), criteria)
    return np.asarray(refined, dtype=np.float64).reshape(-1, 2)


def sample(grey: ImageArray, uv_px: FloatArray) -> FloatArray:
    """Grey levels (...) at pixels (..., 2), between them by interpolation."""
    u, v = np.ascontiguousarray(uv_px.reshape(1, -1, 2).transpose(2, 0, 1), dtype=np.float32)
    values = cv2.remap(grey, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(values, dtype=np.float64).reshape(uv_px.shape[:-1])


def smaller(grey: ImageArray) -> tuple[ImageArray, float]:
    """The image as it is searched, and how many of its own pixels one pixel of that is."""
    scale = max(1.0, max(grey.shape) / SEARCH_SIDE_PX)
    if scale == 1.0:
        return grey, 1.0
    size = (round(grey.shape[1] / scale), round(grey.shape[0] / scale))
    return np.asarray(cv2.resize(grey, size, interpolation=cv2.INTER_AREA), dtype=np.uint8), scale


def blur_px(grey: ImageArray, target: Target, ids: IntArray, corners_px: FloatArray) -> float:
    """Sigma of the blur over the board's edges, px: of the more blurred ones, as motion blurs in one direction.

    The steepest slope of an edge of height h that a Gaussian of sigma s blurred is h / (s sqrt(2 pi)).
    """
    where = np.full(len(target.corners), -1)
    where[ids] = np.arange(len(ids))
    begin, end = where[edges(target)].T
    seen = (begin >= 0) & (end >= 0)
    if not seen.any():
        return 0.0
    p, q = corners_px[begin[seen]], corners_px[end[seen]]
    length = np.linalg.norm(q - p, axis=1)
    across = np.stack([p[:, 1] - q[:, 1], q[:, 0] - p[:, 0]], axis=1) / np.maximum(length, 1e-9)[:, None]
    steps = np.linspace(-1.0, 1.0, 17)
    reach = 0.12 * length  # to the nearest other edge is 0.15 of a ChArUco's square
    profile = sample(grey, (p + q)[:, None] / 2 + across[:, None] * (reach[:, None] * steps)[..., None])
    height = profile.max(axis=1) - profile.min(axis=1)
    slope = np.abs(profile[:, 2:] - profile[:, :-2]).max(axis=1) / (2 * reach * (steps[1] - steps[0]))
    return float(np.percentile(height / np.maximum(slope, 1e-3) / np.sqrt(2 * np.pi), 75))


def edges(target: Target) -> IntArray:
    """Pairs (n, 2) of corner ids with an edge from black to white between them."""
    if target.kind == "aprilgrid":
        first = 4 * np.arange(target.columns * target.rows)[:, None]
        begin = np.arange(4)
        return np.stack([first + begin, first + np.roll(begin, -1)], axis=-1).reshape(-1, 2)
    ids = np.arange(target.columns * target.rows).reshape(target.rows, target.columns)
    pairs = ((ids[:, :-1], ids[:, 1:]), (ids[:-1], ids[1:]))
    return np.concatenate([np.stack([a.ravel(), b.ravel()], axis=1) for a, b in pairs])


class AprilGridFinder:
    """AprilGrids as kalibr prints them: black borders two modules wide, small squares where the gaps cross.

    Those squares touch the tags, which keeps a part of the tags from being found by themselves; what is missing
    is looked for where its neighbours say that it is, and compared with what is printed there.
    """

    # Windows of thresholds, px, and whether on an image twice as large and sharpened, for small and blurred tags. Black
    # tags part from the squares that touch their corners only in thresholds over few pixels, hence these first.
    LOOKS = ((3, 3, False), (5, 9, False), (3, 7, True), (15, 31, False))
    ORDER = (1, 0, 3, 2)  # OpenCV's corners of a tag in kalibr's order
    SEEDS = 4  # tags found by themselves, from which on no other threshold is tried
    LEAST_NEIGHBOURS = 6  # corners that say where others are
    WAVES = 6

    def __init__(self, target: Target) -> None:
        self.target = target
        self._corners = target.corners[:, :2].reshape(-1, 4, 2)
        tags = len(self._corners)
        self._detectors = [(_april_detector(low, high, tags), is_sharpened) for low, high, is_sharpened in self.LOOKS]

    @cached_property
    def _modules(self) -> FloatArray:
        """Printed modules (tags, MODULES**2) of zero mean and unit length, in the order of _module_places."""
        dictionary = april_dictionary()
        pictures = [
            cv2.aruco.generateImageMarker(dictionary, tag, MODULES, borderBits=APRIL_BORDER_BITS)[:, ::-1].ravel()
            for tag in range(len(self._corners))
        ]
        return _normalised(np.array(pictures, dtype=np.float64))

    @cached_property
    def _module_places(self) -> FloatArray:
        """Centres (MODULES**2, 2) of a tag's modules from its corner 0, in its sides."""
        v, u = np.mgrid[:MODULES, :MODULES]
        return (np.stack([u.ravel(), v.ravel()], axis=1) + 0.5) / MODULES

    def find(self, grey: ImageArray) -> Board | None:
        small, scale = smaller(grey)
        seeds = self.find_tags(small)
        if not seeds:
            return None
        grid = _TagGrid(grey, self._corners.shape[0])
        grid.add({tag: (corners + 0.5) * scale - 0.5 for tag, corners in seeds.items()}, is_first_look=True)
        for _ in range(self.WAVES):
            if not grid.add(self._neighbours(grid), is_first_look=False):
                break
        tag, corner = np.nonzero(grid.is_good)
        return Board(4 * tag + corner, grid.corners_px[tag, corner])

    def find_tags(self, grey: ImageArray) -> dict[int, FloatArray]:
        """Corners (4, 2) of the tags that are found by themselves, in kalibr's order."""
        tags: dict[int, FloatArray] = {}
        for detector, is_sharpened in self._detectors:
            quads, ids, _ = detector.detectMarkers(_sharpened(grey) if is_sharpened else grey)
            for quad, tag in zip(quads, [] if ids is None else ids.ravel(), strict=True):
                if int(tag) not in tags:
                    at = np.asarray(quad, dtype=np.float64).reshape(4, 2)[list(self.ORDER)]
                    tags[int(tag)] = (at + 0.5) / 2 - 0.5 if is_sharpened else at
            if len(tags) >= self.SEEDS:
                break
        return tags

    def _neighbours(self, grid: _TagGrid) -> dict[int, FloatArray]:
        """Where tags with corners not yet known are by the corners around, if the image looks like them there."""
        columns, rows = self.target.columns, self.target.rows
        count = grid.is_good.sum(axis=1).reshape(rows, columns)
        is_near = cv2.dilate(np.minimum(count, 1).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
        predicted: dict[int, FloatArray] = {}
        for row, column in np.argwhere(is_near & (count < 4)):
            near = np.zeros((rows, columns), dtype=bool)
            near[max(0, row - 2) : row + 3, max(0, column - 2) : column + 3] = True
            chosen = near.reshape(-1, 1) & grid.is_good
            if chosen.sum() < self.LEAST_NEIGHBOURS:
                continue
            tag = int(row * columns + column)
            H = homography(self._corners[chosen], grid.corners_px[chosen])
            if H is not None:
                corners = cv2.perspectiveTransform(self._corners[tag][None], H)[0]
                if self._likeness(grid.grey, tag, corners) > LIKENESS:
                    predicted[tag] = corners
        return predicted

    def _likeness(self, grey: ImageArray, tag: int, corners_px: FloatArray) -> float:
        """Correlation of the modules seen between four corners with those of a tag."""
        H = _square_to(corners_px)
        seen = sample(grey, cv2.perspectiveTransform(self._module_places[None], H)[0])
        return float(_normalised(seen[None])[0] @ self._modules[tag])


class _TagGrid:
    """The corners of an AprilGrid's tags as they become known in one image."""

    def __init__(self, grey: ImageArray, count: int) -> None:
        self.grey = grey
        self.corners_px = np.zeros((count, 4, 2))
        self.is_good = np.zeros((count, 4), dtype=bool)

    def add(self, tags: dict[int, FloatArray], is_first_look: bool) -> bool:
        """Refine the corners not yet known of these tags. Returns whether any became known.

        A tag that was found by itself is found too small, by some 2 px in its corners: these are looked for farther
        away. Not so what its neighbours predict.
        """
        new = [(tag, corners) for tag, corners in tags.items() if not self.is_good[tag].all()]
        if not new:
            return False
        names = np.array([tag for tag, _ in new])
        at = np.stack([corners for _, corners in new])
        side = float(np.median(np.linalg.norm(at - np.roll(at, 1, axis=1), axis=2)))
        near = self._refined(at, max(4.0, 0.14 * side)) if is_first_look else at
        refined = self._refined(near, 0.1 * side)
        moved = np.linalg.norm(refined - at, axis=2)
        limit = max(4.0, 0.15 * side) if is_first_look else max(1.5, 0.06 * side)
        # OpenCV gives back the very point that it was given where its search ran away.
        good = (moved > 0) & (moved < limit) & _is_saddle(self.grey, refined)
        good &= _is_inside_each(refined, self.grey) & ~self.is_good[names]
        tag, corner = np.nonzero(good)
        self.corners_px[names[tag], corner] = refined[tag, corner]
        self.is_good[names[tag], corner] = True
        return bool(good.any())

    def _refined(self, tags_px: FloatArray, reach_px: float) -> FloatArray:
        inside = _is_inside_each(tags_px, self.grey)
        refined = tags_px.copy()
        if inside.any():
            refined[inside] = refine(self.grey, tags_px[inside], reach_px)
        return refined


class ChessboardFinder:
    """Plain chessboards. The first corner is the one whose inner square is black.

    That tells a turned board from an upright one where one of the counts of corners is odd and the other even. Of a
    board that is seen in part, the part is placed at its beginning: where it really lies nobody can see, and only the
    board's pose depends on it.
    """

    LEAST_PART = (5, 4)  # corners in one direction and the other: noise makes smaller ones

    def __init__(self, target: Target) -> None:
        self.target = target

    def find(self, grey: ImageArray) -> Board | None:
        small, scale = smaller(grey)
        whole = self._find_whole(small)
        grid = self._find_part(small) if whole is None else whole
        if grid is None:
            return None
        spacing = scale * _spacing(grid)
        at = (grid.reshape(-1, 2) + 0.5) * scale - 0.5
        refined = refine(grey, at, 0.2 * spacing)
        stays = np.linalg.norm(refined - at, axis=1) < max(1.5, 0.15 * spacing)
        if whole is None and not stays.all():
            return None
        row, column = np.indices(grid.shape[:2]).reshape(2, -1)
        return Board((row * self.target.columns + column)[stays], refined[stays], ids_are_sure=whole is not None)

    def _find_whole(self, grey: ImageArray) -> FloatArray | None:
        """All corners (rows, columns, 2), the first one's inner square black."""
        size, normalized = (self.target.columns, self.target.rows), cv2.CALIB_CB_NORMALIZE_IMAGE
        # Without a white border and through a fisheye only the older search finds boards, blurred ones only the newer.
        # Its FAST_CHECK stays off: it passes over boards that are far off or tilted by more than 60 degrees.
        for search, flags in (
            (cv2.findChessboardCorners, normalized | cv2.CALIB_CB_ADAPTIVE_THRESH),
            (cv2.findChessboardCornersSB, normalized),
        ):
            found, corners = search(grey, size, flags=flags)
            if found:
                grid = np.asarray(corners, dtype=np.float64).reshape(*size[::-1], 2)
                squares = _squares(grey, grid)
                if _alternate(squares):
                    return grid[::-1, ::-1] if _are_white(squares)[0, 0] else grid
        return None

    def _find_part(self, grey: ImageArray) -> FloatArray | None:
        """Corners (rows, columns, 2) of a part of the board; None where what is seen is no part of it."""
        flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_LARGER
        found, corners, meta = cv2.findChessboardCornersSBWithMeta(grey, self.LEAST_PART, flags)
        if not found:
            return None
        rows, columns = np.shape(meta)[:2]
        grid = np.asarray(corners, dtype=np.float64).reshape(rows, columns, 2)
        if rows > self.target.rows or columns > self.target.columns:
            grid = np.rot90(grid)  # a quarter turn, which unlike a transposition is no mirror image
        fits = grid.shape[0] <= self.target.rows and grid.shape[1] <= self.target.columns
        return grid if fits and _alternate(_squares(grey, grid)) else None  # OpenCV may pass over a row


class CharucoFinder:
    """ChArUco boards: a chessboard whose white squares say where on it they are. Both ways to print it are tried."""

    def __init__(self, target: Target) -> None:
        self.target = target
        parameters = cv2.aruco.CharucoParameters()
        parameters.minMarkers = 1  # beside a corner: the other one is often beyond the image
        are_two = (target.rows + 1) % 2 == 0
        boards = [charuco_board(target, is_legacy) for is_legacy in ((False, True) if are_two else (False,))]
        self._detectors = [cv2.aruco.CharucoDetector(board, parameters) for board in boards]

    def find(self, grey: ImageArray) -> Board | None:
        small, scale = smaller(grey)
        for detector in self._detectors:
            corners, ids, _, _ = detector.detectBoard(small)
            if ids is not None and len(ids) >= LEAST_CORNERS:
                self._detectors.sort(key=lambda other: other is not detector)  # the next image will show it, too
                return self._refined(grey, scale, corners, ids)
        return None

    def _refined(self, grey: ImageArray, scale: float, corners: Any, ids: Any) -> Board:
        at = (np.asarray(corners, dtype=np.float64).reshape(-1, 2) + 0.5) * scale - 0.5
        ids = np.asarray(ids, dtype=np.int64).ravel()
        spacing = _spacing_of_ids(at, ids, self.target)
        refined = refine(grey, at, 0.14 * spacing)
        stays = np.linalg.norm(refined - at, axis=1) < max(1.5, 0.1 * spacing)
        return Board(ids[stays], refined[stays])


def _sharpened(grey: ImageArray) -> ImageArray:
    """The image at twice its size, with what a blur of some 2 px took away put back in part."""
    large = cv2.resize(grey, None, fx=2.0, fy=2.0, interpolation=cv2.INTER_LINEAR)
    return np.asarray(cv2.addWeighted(large, 3.0, cv2.GaussianBlur(large, (0, 0), 4.0), -2.0, 0.0), dtype=np.uint8)


def _april_detector(low: int, high: int, tags: int) -> Any:
    """Of a board's own tags only: three quarters of the time would go into comparing with all the others."""
    dictionary = april_dictionary()
    dictionary.bytesList = dictionary.bytesList[:tags]
    parameters = cv2.aruco.DetectorParameters()
    parameters.markerBorderBits = APRIL_BORDER_BITS
    # OpenCV's own refinements take hold of the squares beside the corners: 2.3 px rms.
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_NONE
    parameters.adaptiveThreshWinSizeMin, parameters.adaptiveThreshWinSizeMax = low, high
    parameters.adaptiveThreshWinSizeStep = max(1, high - low)
    return cv2.aruco.ArucoDetector(dictionary, parameters)


def _normalised(rows: FloatArray) -> FloatArray:
    centred = rows - rows.mean(axis=1, keepdims=True)
    return np.asarray(centred / np.maximum(np.linalg.norm(centred, axis=1, keepdims=True), 1e-9))


def _square_to(corners_px: FloatArray) -> FloatArray:
    """Homography (3, 3) from a tag's corners in its sides to pixels."""
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], dtype=np.float32)
    return np.asarray(cv2.getPerspectiveTransform(square, corners_px.astype(np.float32)), dtype=np.float64)


def _is_inside_each(uv_px: FloatArray, grey: ImageArray, margin: float = 4.0) -> BoolArray:
    height, width = grey.shape[:2]
    low, high = margin, np.array([width - 1 - margin, height - 1 - margin])
    return np.asarray(((uv_px > low) & (uv_px < high)).all(axis=-1))


def _is_saddle(grey: ImageArray, tags_px: FloatArray) -> BoolArray:
    """Whether black meets black and white meets white across each corner (n, 4) of tags (n, 4, 2)."""
    d = 0.12  # of the tag's side, off the corner
    out = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], dtype=np.float64)  # away from the tag, at each corner
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], dtype=np.float64)
    black = np.concatenate([square + d * out, square - d * out])
    white = np.concatenate([square + d * out * (1, -1), square + d * out * (-1, 1)])
    places = np.concatenate([black, white])[None]
    seen = np.stack([sample(grey, cv2.perspectiveTransform(places, _square_to(tag))[0]) for tag in tags_px])
    dark, bright = seen[:, :8].reshape(-1, 2, 4).max(axis=1), seen[:, 8:].reshape(-1, 2, 4).min(axis=1)
    return np.asarray(bright - dark > LEAST_CONTRAST)


def _squares(grey: ImageArray, grid: FloatArray) -> FloatArray:
    """Grey levels (rows - 1, columns - 1, 4) in the quarters of the squares between corners (rows, columns, 2)."""
    first, fourth = np.linspace(0.17, 0.33, 3), np.linspace(0.67, 0.83, 3)  # of the square's side
    quarters = []
    for down in (first, fourth):
        for across in (first, fourth):
            v, u = (part[:, :, None, None, None] for part in np.meshgrid(down, across, indexing="ij"))
            upper = (1 - u) * grid[:-1, :-1] + u * grid[:-1, 1:]
            lower = (1 - u) * grid[1:, :-1] + u * grid[1:, 1:]
            quarters.append(sample(grey, (1 - v) * upper + v * lower).mean(axis=(0, 1)))
    return np.stack(quarters, axis=-1)


def _are_white(squares: FloatArray) -> BoolArray:
    """Which squares (rows, columns) of a chessboard are the white ones, by the levels (rows, columns, 4) of all."""
    is_like_first = np.indices(squares.shape[:2]).sum(axis=0) % 2 == 0
    first_is_white = squares[is_like_first].mean() > squares[~is_like_first].mean()
    return np.asarray(is_like_first == first_is_white)


def _alternate(squares: FloatArray) -> bool:
    """Whether neighbours are one square all white and one all black, nearly everywhere: not where a row is left out."""
    is_white, darkest, brightest = _are_white(squares), squares.min(axis=2), squares.max(axis=2)
    pairs = ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:]))
    is_right = [np.where(is_white[a], darkest[a] > brightest[b], darkest[b] > brightest[a]).ravel() for a, b in pairs]
    return bool(np.concatenate(is_right).mean() > ALTERNATING)


def _spacing(grid: FloatArray) -> float:
    """The smallest distance of neighbours in a grid (rows, columns, 2)."""
    across = np.linalg.norm(np.diff(grid, axis=1), axis=2)
    down = np.linalg.norm(np.diff(grid, axis=0), axis=2)
    return float(min(across.min(), down.min()))


def _spacing_of_ids(corners_px: FloatArray, ids: IntArray, target: Target) -> float:
    flat = np.full((target.rows * target.columns, 2), np.nan)
    flat[ids] = corners_px
    grid = flat.reshape(target.rows, target.columns, 2)
    steps = [np.linalg.norm(np.diff(grid, axis=axis), axis=2).ravel() for axis in (0, 1)]
    known = np.concatenate(steps)
    known = known[np.isfinite(known)]
    return float(known.min()) if len(known) else 10.0
