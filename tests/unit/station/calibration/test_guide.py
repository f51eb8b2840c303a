"""What the person who holds the board is told, and how honestly the meter says what is known."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from shared.calibration import CameraCalibration
from station.calibration.boards import make_finder, view_board
from station.calibration.guide import Guide, Pose
from station.calibration.meter import read_meter
from station.calibration.target import BoardView, Target
from station.vision.lens import Lens
from tests.support.paths import RECORDINGS
from tests.support.target_images import T_cam_board

GRID = Target("aprilgrid", 5, 7, 0.024, gap_m=0.0072)
CHESS = Target("chessboard", 8, 6, 0.025)
CAMERA = CameraCalibration(width=640, height=480, fx=500.0, fy=500.0, cx=319.5, cy=239.5, distortion=(-0.2, 0.0, 0, 0))
EUROC = RECORDINGS / "aprilgrid_euroc"


def seen(
    target: Target,
    tilt: tuple[float, float, float] = (0.0, 0.0, 0.0),
    distance_m: float = 0.4,
    shift: tuple[float, float] = (0.0, 0.0),
    **changes: float,
) -> BoardView:
    """The corners of a board that are inside the picture."""
    T = T_cam_board(target, np.array(tilt), distance_m, shift)
    p_cam = target.corners @ T[:3, :3].T + T[:3, 3]
    uv = Lens(CAMERA).project(p_cam[:, :2] / p_cam[:, 2:])
    inside = ((uv >= 0) & (uv <= [639, 479])).all(axis=1)
    return BoardView("picture", 1, np.flatnonzero(inside), uv[inside], blur_px=changes.get("blur_px", 0.8))


@pytest.mark.parametrize("target", [GRID, CHESS], ids=lambda target: target.kind)
@pytest.mark.parametrize(
    ("tilt", "distance_m", "pose"),
    [
        # Turned about x (to the right) the lower edge goes away, about y (down) the right one comes.
        ((0.5, 0.0, 0.0), 0.5, Pose.UPPER),
        ((-0.5, 0.0, 0.0), 0.5, Pose.LOWER),
        ((0.0, 0.5, 0.0), 0.5, Pose.RIGHT),
        ((0.0, -0.5, 0.0), 0.5, Pose.LEFT),
        ((0.0, 0.0, 0.8), 0.5, Pose.FLAT),
        ((0.0, 0.0, 0.0), 0.18, Pose.NEAR),
        ((0.0, 0.0, 0.0), 0.9, Pose.FAR),
    ],
)
def test_a_pose_has_the_name_a_person_gives_it(
    target: Target, tilt: tuple[float, float, float], distance_m: float, pose: Pose
) -> None:
    view = seen(target, tilt, distance_m)
    edge = {Pose.LEFT: (0, 1), Pose.RIGHT: (0, -1), Pose.UPPER: (1, 1), Pose.LOWER: (1, -1)}.get(pose)
    if edge is not None:  # what is nearer looks larger: asked of the corners themselves
        axis, sign = edge
        at = view.corners_px - view.corners_px.mean(axis=0)
        low, high = at[at[:, axis] < 0], at[at[:, axis] > 0]
        assert sign * (np.ptp(low[:, 1 - axis]) - np.ptp(high[:, 1 - axis])) > 0
    found = Guide(target, CAMERA).poses_of(view)
    assert pose in found
    tilts = {Pose.LEFT, Pose.RIGHT, Pose.UPPER, Pose.LOWER, Pose.FLAT}
    assert len(found & tilts) == 1  # of boards that are turned about one axis


def test_only_still_sharp_and_new_views_count() -> None:
    guide = Guide(GRID, CAMERA)
    assert "sees it" in guide.look(None).instruction
    assert "hold it still" in guide.look(seen(GRID)).instruction  # the first one: it may be moving
    assert guide.look(seen(GRID)).is_taken
    assert not guide.look(seen(GRID)).is_taken  # nothing new
    assert not guide.look(seen(GRID, shift=(0.2, 0.0))).is_taken  # on its way there
    blurred = guide.look(seen(GRID, shift=(0.2, 0.0), blur_px=4.0))
    assert not blurred.is_taken and "focus" in blurred.instruction
    there = guide.look(seen(GRID, shift=(0.2, 0.0)))
    assert there.is_taken and there.num_views == 2


def test_who_does_what_is_said_is_told_that_it_is_enough() -> None:
    guide = Guide(GRID, CAMERA)
    told: list[str] = []
    rng = np.random.default_rng(1)
    for _ in range(400):
        view = seen(
            GRID,
            (float(rng.uniform(-0.7, 0.7)), float(rng.uniform(-0.7, 0.7)), float(rng.uniform(-0.5, 0.5))),
            float(rng.uniform(0.22, 0.9)),
            (float(rng.uniform(-0.5, 0.5)), float(rng.uniform(-0.4, 0.4))),
        )
        guide.look(view)
        now = guide.look(view)
        told.append(now.instruction)
        if now.is_enough:
            break
    assert now.is_enough and told[-1].startswith("enough")
    assert all(share == 1.0 for share in (*now.cells, *now.poses.values()))
    assert any("left edge nearer" in text for text in told) or any("corner of the picture" in text for text in told)


@pytest.mark.skipif(not EUROC.exists(), reason="the recorded boards are not here")
def test_the_meter_is_honest_on_real_boards() -> None:
    target = Target("aprilgrid", 6, 6, 0.088, gap_m=0.3 * 0.088)
    told = CameraCalibration(width=752, height=480, fx=500.0, fy=500.0, cx=375.5, cy=239.5)
    finder = make_finder(target)
    views = []
    for number, path in enumerate(sorted(EUROC.glob("*.jpg"))):
        image = np.asarray(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE), dtype=np.uint8)
        view = view_board(finder, target, image, path.name, number)
        views += [] if view is None else [view]
    assert len(views) >= 20
    assert read_meter(views[:5], target, told) == ()
    published = {"focal length": 458.654, "centre": 367.215, "distortion": -0.28341}
    for count in (12, 16, len(views)):
        for reading in read_meter(views[:count], target, told):
            assert abs(reading.value - published[reading.name]) < 4 * reading.sigma, (count, reading)
    first, last = read_meter(views[:8], target, told), read_meter(views, target, told)
    assert all(after.sigma < before.sigma for before, after in zip(first, last, strict=True))
