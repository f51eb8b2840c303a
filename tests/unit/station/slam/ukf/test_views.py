"""Views of the ukf's map: chosen, thinned, levelled."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import cv2
import numpy as np
import pytest

from shared.calibration import REFERENCE_HEAD, REFERENCE_ROBOT
from shared.geometry import FloatArray, se3, so3_exp
from station.model.frames import ImageFrame
from station.model.navigation import Keyframes, Landmarks
from station.motion.head import HeadPose, HeadThen
from station.slam.mapping.assemble import Reconstructed
from station.slam.ukf.map.keyframes import Keyframe
from station.slam.ukf.map.view_map import level, relative_motions, spaced, straight_rays
from station.slam.ukf.map.views import MapViews, ViewConfig
from station.vision.camera_model import CameraModel
from station.vision.features import FeatureExtractor, extract_encoded
from station.vision.klt import TrackedFrame
from tests.support.paths import ROOT

assert REFERENCE_ROBOT.camera is not None and REFERENCE_ROBOT.imu is not None
CAMERA, NOISE = REFERENCE_ROBOT.camera, REFERENCE_ROBOT.imu
MODEL = CameraModel.of(CAMERA, 1.0)


def picture() -> bytes:
    small = np.random.default_rng(0).integers(0, 255, (30, 40)).astype(np.uint8)
    return bytes(cv2.imencode(".png", cv2.resize(small, (640, 480), interpolation=cv2.INTER_CUBIC))[1].tobytes())


PICTURE = picture()


def keyframe(number: int, moved_px: float, segment: int = 0, T: FloatArray | None = None) -> Keyframe:
    """All features moved that far since the first keyframe."""
    uv = np.random.default_rng(1).uniform(200, 400, (50, 2)) + np.array([moved_px, 0.0])
    tracked = TrackedFrame(np.arange(50), uv, MODEL.lens.unproject(uv), 50, 100.0)
    image = ImageFrame(number, number * 250_000_000, 0, PICTURE)
    pose = np.eye(4) if T is None else T
    rgb = np.zeros((50, 3), dtype=np.uint8)
    return Keyframe(image, tracked, rgb, pose, np.zeros(3), np.array([0.0, 0.0, 0.4]), np.zeros(6), segment, None, None)


def test_a_keyframe_becomes_a_view_when_the_picture_has_moved_or_a_segment_begins() -> None:
    views = MapViews(MODEL.lens, ViewConfig(min_flow=0.2), 0)
    for number, (moved, segment) in enumerate([(0.0, 0), (50.0, 0), (130.0, 0), (140.0, 0), (140.0, 1)]):
        views.add(keyframe(number, moved, segment))
    items, pairs = views.describe_all()
    assert [v.frame_index for v in items] == [0, 2, 4]
    assert [(a, b) for a, b, _ in pairs] == [(0, 1)]  # never across segments
    assert len(pairs[0][2]) > 100


def test_segments_that_carry_on_are_one_piece_and_are_matched() -> None:
    views = MapViews(MODEL.lens, ViewConfig(min_flow=0.2), 0)
    views.carried_on |= {1, 3}
    for number in range(4):
        views.add(keyframe(number, 200.0 * number, number))
    assert [views.piece(segment) for segment in range(4)] == [0, 0, 2, 2]
    _, pairs = views.describe_all()
    assert [(a, b) for a, b, _ in pairs] == [(0, 1), (2, 3)]


def test_a_motion_through_an_outage_counts_little_and_may_be_wrong() -> None:
    views = MapViews(MODEL.lens, ViewConfig(min_flow=0.2), 0)
    views.carried_on.add(1)
    for number, segment in enumerate((0, 0, 1, 1)):
        views.add(keyframe(number, 200.0 * number, segment, se3(np.eye(3), np.array([0.2 * number, 0.0, 0.0]))))
    motions = relative_motions(views.describe_all()[0], NOISE)
    assert motions.slips.tolist() == [False, True, False]
    assert np.allclose(motions.p[:, 0], 0.2)
    assert motions.sigma_position[1, 0] > 5 * motions.sigma_position[[0, 2], 0].max()
    assert motions.sigma_rotation[1] > 5 * motions.sigma_rotation[0]


def test_views_keep_a_distance_in_time() -> None:
    views = MapViews(MODEL.lens, ViewConfig(min_flow=0.2, min_interval_s=0.6), 0)
    for number in range(6):  # a quarter of a second and enough motion between each
        views.add(keyframe(number, 130.0 * number))
    assert [v.frame_index for v in views.describe_all()[0]] == [0, 3]


def test_a_head_that_turns_with_its_body_shows_another_view_sooner() -> None:
    """Views that overlap by half only leave most of what they show in fewer than three: no landmarks."""
    chosen = []
    for T_body_head in (None, np.eye(4)):
        views = MapViews(MODEL.lens, ViewConfig(), 0)
        for number in range(9):  # 80 degrees a second, 20 pictures a second: a fifteenth of the width each
            turned = se3(so3_exp(np.array([0.0, 0.0, np.radians(4.0) * number])), np.zeros(3))
            shown = keyframe(number, 45.0 * number, T=turned)
            image = ImageFrame(number, number * 50_000_000, 0, PICTURE)
            views.add(replace(shown, image=image, T_body_head=T_body_head))
        chosen.append([v.frame_index for v in views.describe_all()[0]])
    assert chosen == [[0, 4, 8], [0, 2, 4, 6, 8]]


def test_views_of_a_turned_head_that_are_near_in_time_are_not_asked_of_the_imu() -> None:
    """By how pictures err within a tenth of a second its maps were 2 % too small."""
    head = HeadThen(HeadPose(REFERENCE_HEAD, np.zeros(2), np.zeros(2), np.zeros(2)), np.zeros(2))
    for then, expected in ((None, [0, 1, 2, 3, 4]), (head, [0, 2, 4])):
        views = MapViews(MODEL.lens, ViewConfig(), 0)
        for number in range(9):
            image = ImageFrame(number, number * 50_000_000, 0, PICTURE)
            turned = se3(so3_exp(np.array([0.0, 0.0, np.radians(4.0) * number])), np.zeros(3))
            shown = keyframe(number, 45.0 * number, T=turned)
            shown = replace(shown, image=image, T_body_head=np.eye(4), head=then)
            views.add(shown)
        assert spaced(views.describe_all()[0]) == expected


def test_many_views_are_thinned_and_stay_connected() -> None:
    views = MapViews(MODEL.lens, ViewConfig(min_flow=0.2, capacity=8, num_previous=4), 0)
    for number in range(18):
        views.add(keyframe(number, 130.0 * number))
    items, pairs = views.describe_all()
    assert 4 <= len(items) <= 8
    assert {i for a, b, _ in pairs for i in (a, b)} <= set(range(len(items)))
    neighbours = {(a, b) for a, b, _ in pairs}
    assert all((i, i + 1) in neighbours for i in range(len(items) - 1))


def test_views_chosen_anew_are_as_if_there_had_been_no_others() -> None:
    anew, alone = (MapViews(MODEL.lens, ViewConfig(min_flow=0.2), 0) for _ in range(2))
    others, wanted = [keyframe(n, 150.0 * n) for n in range(3)], [keyframe(n, 140.0 * n) for n in range(1, 4)]
    for k in others:
        anew.add(k)
    anew.describe_next()
    anew.begin_anew(wanted)
    for k in wanted:
        alone.add(k)
    (items, pairs), (items_alone, pairs_alone) = anew.describe_all(), alone.describe_all()
    assert [v.frame_index for v in items] == [v.frame_index for v in items_alone] == [1, 2, 3]
    assert [(a, b, len(p)) for a, b, p in pairs] == [(a, b, len(p)) for a, b, p in pairs_alone]


@pytest.mark.parametrize("every", [1, 2, 5])
def test_views_are_the_same_whenever_there_was_time_to_describe_them(every: int) -> None:
    at_once, later = (MapViews(MODEL.lens, ViewConfig(min_flow=0.2, capacity=8), 0) for _ in range(2))
    for number in range(18):
        at_once.add(keyframe(number, 130.0 * number))
        at_once.describe_next()
        later.add(keyframe(number, 130.0 * number))
        if number % every == 0:
            later.describe_next()
    (items, pairs), (items_later, pairs_later) = at_once.describe_all(), later.describe_all()
    assert [v.frame_index for v in items] == [v.frame_index for v in items_later]
    assert [(a, b) for a, b, _ in pairs] == [(a, b) for a, b, _ in pairs_later]
    assert all(np.array_equal(x[2], y[2]) for x, y in zip(pairs, pairs_later, strict=True))
    assert not later.describe_next()


def test_a_view_is_described_as_localisation_describes_its_picture() -> None:
    views = MapViews(MODEL.lens, ViewConfig(), 0)
    views.add(keyframe(0, 0.0))
    view = views.describe_all()[0][0]
    direct = extract_encoded(PICTURE, FeatureExtractor())
    assert np.array_equal(views.seen(0).uv_px, direct.uv_px)
    assert np.array_equal(views.seen(0).descriptors, direct.descriptors)
    assert views.pictures() == [PICTURE]
    assert {tuple(uv) for uv in direct.uv_px.tolist()} <= {tuple(uv) for uv in view.features.uv_px.tolist()}


def test_the_filter_can_be_imported_where_pycolmap_is_missing() -> None:
    missing = "import sys; sys.modules['pycolmap'] = None; import station.slam.ukf.backend"
    subprocess.run([sys.executable, "-c", missing], check=True, cwd=ROOT)


def test_relative_motions_chain_to_the_filters_poses() -> None:
    rng = np.random.default_rng(2)
    T = [se3(so3_exp(rng.normal(0, 0.3, 3)), rng.normal(0, 1, 3)) for _ in range(5)]
    views = MapViews(MODEL.lens, ViewConfig(min_flow=0.0, num_previous=1), 0)
    for number, pose in enumerate(T):
        views.add(keyframe(number, 10.0 * number, 0, pose))
    motions = relative_motions(views.describe_all()[0], NOISE)
    end = T[0]
    for R, p in zip(motions.R, motions.p, strict=True):
        end = end @ se3(R, p)
    assert np.allclose(end, T[-1])
    assert (motions.sigma_rotation > 0).all() and (motions.sigma_position > 0).all()


def test_rows_exposed_later_see_where_the_middle_row_would_have_seen() -> None:
    views = MapViews(MODEL.lens, ViewConfig(), 0)
    views.add(keyframe(0, 0.0))
    view = views.describe_all()[0][0]
    rays = straight_rays(view, MODEL)
    uv = view.features.uv_px
    xy = MODEL.lens.unproject(uv)
    middle = np.abs(uv[:, 1] - MODEL.middle_row) < 2.0
    assert np.allclose(rays[middle], xy[middle], atol=1e-4)
    # The body turns left: a later row sees a resting point further right in the picture than the middle row did.
    late, early = uv[:, 1] > 400.0, uv[:, 1] < 80.0
    assert (rays[late, 0] < xy[late, 0]).all() and (rays[early, 0] > xy[early, 0]).all()


@pytest.mark.parametrize("tilt", [[0.02, 0.0, 0.0], [-0.01, 0.03, 0.0]])
def test_the_filters_vertical_is_restored(tilt: list[float]) -> None:
    rng = np.random.default_rng(4)
    T_filter = np.array([se3(so3_exp(np.array([0.0, 0.0, a])), rng.normal(0, 2, 3)) for a in rng.normal(0, 1, 20)])
    wrong = se3(so3_exp(np.array(tilt)), np.zeros(3))
    p = rng.normal(0, 2, (6, 3))
    keyframes = Keyframes(
        np.arange(20), np.arange(20), wrong @ T_filter @ CAMERA.T_body_cam_matrix, (b"",) * 20, np.zeros(20, np.int64)
    )
    none = np.zeros(0, np.int64)
    landmarks = Landmarks(
        p @ wrong[:3, :3].T, np.zeros((6, 3), np.uint8), np.zeros((6, 3, 3)), none, none, np.zeros((0, 2))
    )
    fixed = level(Reconstructed(keyframes, landmarks, CAMERA), T_filter, CAMERA)
    T = fixed.keyframes.T_world_cam @ CAMERA.T_cam_body_matrix
    assert np.allclose(T[:, 2, :3], T_filter[:, 2, :3], atol=1e-9)  # "up" in every body frame
    assert np.allclose(np.ptp(fixed.landmarks.p_world[:, 2] - p[:, 2]), 0.0, atol=1e-9)
