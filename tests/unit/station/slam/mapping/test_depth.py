"""Depth gives metres to a map without, and its scans to every map."""

import contextlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from robot.devices.pi.hc_sr04 import calibration_of
from shared.calibration import Calibration, DepthCalibration
from shared.errors import DataError
from station.datasets import Dataset
from station.model.frames import DepthFrame, DriveSample, ImageFrame
from station.slam.mapping.depth import MAX_SCANS, MAX_SIDE, DepthLog, scale_from_depth, step_of, with_depth
from station.slam.run import content_digest, run_backend
from station.workers.replay import ReplayOptions, run_slam
from station.workers.slam import NavigationSlam
from tests.support.depth import CAMERA, STEP_NS, Made, depth_camera, encoded, frames, map_of, way


def log_of(pictures: list[DepthFrame]) -> DepthLog:
    log = DepthLog()
    for picture in pictures:
        log.add(picture)
    return log


ZONES = DepthCalibration(
    width=8, height=8, fx=4 / np.tan(np.pi / 8), fy=4 / np.tan(np.pi / 8), cx=3.5, cy=3.5,
    T_body_depth=depth_camera().T_body_depth,
)  # fmt: skip


@pytest.mark.parametrize("unit_m", [0.2, 0.97, 40.0])
@pytest.mark.parametrize("sensor", [depth_camera(), depth_camera(320, 240, aside_m=-0.1), ZONES])
def test_a_map_by_images_gets_its_metres_from_depth(sensor: DepthCalibration, unit_m: float) -> None:
    T = way()
    made = with_depth(map_of(T, unit_m), log_of(frames(sensor, T)))
    assert made.is_metric
    found = made.report.config["depth"]
    assert found["scans"] == 20
    assert abs(np.log(found["scale"] / unit_m)) < min(0.02, 2 * found["sigma"])
    np.testing.assert_allclose(made.trajectory.T_world_body[:, :3, 3], T[:, :3, 3], rtol=0.02)
    np.testing.assert_allclose(made.landmarks.p_world, map_of(T).landmarks.p_world, rtol=0.02, atol=0.02)
    turned = map_of(T).keyframes.T_world_cam[:, :3, :3]
    np.testing.assert_allclose(made.keyframes.T_world_cam[:, :3, :3], turned, atol=1e-12)


def test_a_cone_says_nothing_of_a_map() -> None:
    """Nobody knows where in it the thing is: no walls come of it, no metres, no sentence that it lacks landmarks."""
    T = way()
    plain = map_of(T, 0.5)
    sonar, picture = calibration_of((0.1, 0.0, 0.0)), encoded(np.array([[1500]], dtype=np.uint16))
    made = with_depth(plain, log_of([DepthFrame(k * STEP_NS, picture, sonar) for k in range(len(T))]))
    assert made is plain


def test_the_scale_is_told_as_unsure_as_the_pictures_differ() -> None:
    T, sensor = way(), depth_camera()
    pictures = frames(sensor, T)
    wrong = [
        replace(f, encoded=encoded(np.round(f.millimetres() * factor).astype(np.uint16)))
        for f, factor in zip(pictures, np.exp(np.random.default_rng(3).normal(0, 0.05, len(pictures))), strict=True)
    ]
    scans = log_of(wrong).scans()
    assert scans is not None
    found = scale_from_depth(map_of(T, 0.5), scans)
    assert found is not None
    assert 0.025 < found.sigma_relative < 0.1
    assert abs(np.log(found.scale / 0.5)) < 2 * found.sigma_relative


def test_half_of_the_pictures_at_fault_do_not_make_a_map_metric() -> None:
    T, sensor = way(), depth_camera()
    pictures = frames(sensor, T)
    wrong = [
        replace(f, encoded=encoded((f.millimetres() * (0.6 if k % 2 else 1.0)).astype(np.uint16)))
        for k, f in enumerate(pictures)
    ]
    made = with_depth(map_of(T, 0.5), log_of(wrong))
    assert not made.is_metric
    assert "differ by" in made.report.messages[-1]


def test_a_map_with_metres_keeps_them_and_says_what_depth_makes_of_them() -> None:
    T, sensor = way(), depth_camera()
    log = log_of(frames(sensor, T))
    metric = map_of(T)
    made = with_depth(metric, log)
    assert content_digest(made) == content_digest(metric)
    assert made.report.messages == ()
    short = map_of(T, 0.9)
    short = replace(short, report=replace(short.report, scale="metric"))
    made = with_depth(short, log)
    assert content_digest(made) == content_digest(short)
    assert "by depth, lengths are 0.9" in made.report.messages[-1]


def test_pieces_with_scales_of_their_own_stay_without_metres() -> None:
    T, sensor = way(), depth_camera()
    pieces = map_of(T, 0.5)
    segment = (np.arange(len(pieces.keyframes)) > 20).astype(np.int64)
    pieces = replace(pieces, keyframes=replace(pieces.keyframes, segment=segment))
    made = with_depth(pieces, log_of(frames(sensor, T)))
    assert not made.is_metric
    assert content_digest(made) == content_digest(pieces)
    assert made.depth is not None


def test_where_depth_shows_no_landmark_there_are_no_metres() -> None:
    T, sensor = way(), depth_camera()
    nothing = [replace(f, encoded=encoded(np.full((120, 160), 65535, np.uint16))) for f in frames(sensor, T)]
    made = with_depth(map_of(T, 0.5), log_of(nothing))
    assert not made.is_metric
    assert "too few landmarks" in made.report.messages[-1]


def test_no_backend_sees_depth_and_without_it_no_bit_is_another() -> None:
    T, sensor = way(), depth_camera()
    arbitrary = map_of(T, 0.5)
    images: list[DriveSample | ImageFrame | DepthFrame] = [ImageFrame(k, k * STEP_NS, 0, b"") for k in range(40)]
    mixed = sorted([*images, *frames(sensor, T)], key=lambda e: e.t_robot_ns)
    without, beside = Made(arbitrary), Made(arbitrary)
    plain, metric = run_backend(without, iter(images)), run_backend(beside, iter(mixed))
    assert without.order == beside.order == images
    assert with_depth(arbitrary, DepthLog()) is arbitrary
    assert plain.depth is None and "depth" not in plain.report.config and not plain.is_metric
    assert plain.id == f"{arbitrary.id}-{content_digest(arbitrary)}"
    assert metric.is_metric and metric.depth is not None


def test_a_damaged_depth_picture_of_a_recording_is_left_out_and_told(caplog: pytest.LogCaptureFixture) -> None:
    T, sensor = way(), depth_camera()
    pictures = frames(sensor, T)
    whole, beside = (Made(map_of(T, 0.5)) for _ in range(2))
    without = run_backend(whole, iter([*pictures[:3], *pictures[4:]]))
    damaged = run_backend(beside, iter([*pictures[:3], replace(pictures[3], encoded=b"no picture"), *pictures[4:]]))
    assert damaged.id == without.id and damaged.is_metric
    assert [r.message.endswith("; it is left out") for r in caplog.records] == [True]


def test_the_worker_of_a_running_robot_does_the_same() -> None:
    T, sensor = way(), depth_camera()
    slam = NavigationSlam(lambda _: None)
    slam.begin("tests.support.depth:half_sized_room", Calibration(camera=CAMERA, imu=None), 0)
    for event in (*frames(sensor, T), *(ImageFrame(k, k * STEP_NS, 0, b"") for k in range(40))):
        if isinstance(event, DepthFrame):
            slam.add_depth(event)
        else:
            slam.add_frame(event)
    made = slam.complete("kitchen")
    assert made.is_metric and made.depth is not None and len(made.depth) == 20
    assert made.report.config["depth"]["scale"] == pytest.approx(0.5, rel=0.02)


def test_a_replay_goes_on_without_a_damaged_depth_picture(caplog: pytest.LogCaptureFixture) -> None:
    first, *others = frames(depth_camera(), way())
    images = [ImageFrame(k, k * STEP_NS, 0, b"") for k in range(40)]
    data = Dataset(
        path=Path("kitchen"),
        kind="images",
        calibration=Calibration(camera=CAMERA, imu=None),
        intrinsics_known=True,
        frame_times_ns=np.array([image.t_robot_ns for image in images]),
        read_frames=lambda: iter(images),
        read_depth=lambda: iter([replace(first, encoded=b"no picture"), *others]),
    )
    slam, _ = run_slam(data, ReplayOptions("tests.support.depth:half_sized_room"), lambda _: None, lambda _: None)
    made = slam.complete("kitchen")
    assert made.depth is not None and len(made.depth) == len(others)
    assert [r.message.endswith("; it is left out") for r in caplog.records] == [True]


def test_a_log_is_bounded_and_spans_all_of_the_way() -> None:
    sensor = depth_camera(8, 6)
    picture = encoded(np.full((6, 8), 1000, np.uint16))
    log = log_of([DepthFrame(k, picture, sensor) for k in range(3 * MAX_SCANS)])
    scans = log.scans()
    assert scans is not None
    assert MAX_SCANS / 2 < len(scans) <= MAX_SCANS
    assert scans.t_robot_ns[0] == 0 and scans.t_robot_ns[-1] > 3 * MAX_SCANS - 10
    assert len(np.unique(np.diff(scans.t_robot_ns))) == 1


def test_pictures_are_thinned_and_their_pixels_lie_where_they_lay() -> None:
    sensor = depth_camera(640, 480)
    millimetres = np.arange(640 * 480, dtype=np.uint32).reshape(480, 640).astype(np.uint16) // 8
    scans = log_of([DepthFrame(0, encoded(millimetres), sensor)]).scans()
    assert scans is not None
    assert scans.millimetres.shape == (1, 48, 64) and max(scans.millimetres.shape[1:]) <= MAX_SIDE
    step = step_of(sensor)
    v, u = 17 * step + (step - 1) // 2, 40 * step + (step - 1) // 2
    assert scans.millimetres[0, 17, 40] == millimetres[v, u]
    assert (40 - scans.sensor.cx) / scans.sensor.fx == pytest.approx((u - sensor.cx) / sensor.fx)
    assert (17 - scans.sensor.cy) / scans.sensor.fy == pytest.approx((v - sensor.cy) / sensor.fy)


def test_a_damaged_picture_costs_itself_only() -> None:
    sensor = depth_camera(8, 6)
    picture = encoded(np.full((6, 8), 1000, np.uint16))
    log = log_of([DepthFrame(0, picture, sensor)])
    with pytest.raises(DataError):
        log.add(DepthFrame(1, picture[:50], sensor))
    for t in (2, 3):
        log.add(DepthFrame(t, picture, sensor))
    scans = log.scans()
    assert scans is not None and scans.t_robot_ns.tolist() == [0, 2, 3] and len(scans.millimetres) == 3


def test_times_that_do_not_go_on_and_other_sensors_are_refused() -> None:
    sensor = depth_camera(8, 6)
    picture = encoded(np.full((6, 8), 1000, np.uint16))
    scans = log_of([DepthFrame(t, picture, sensor) for t in (5, 5, 3, 6)]).scans()
    assert scans is not None and scans.t_robot_ns.tolist() == [5, 6]
    log = log_of([DepthFrame(0, picture, sensor)])
    with pytest.raises(DataError, match="another sensor"):
        log.add(DepthFrame(1, picture, depth_camera(8, 6, aside_m=0.2)))


@pytest.mark.parametrize(
    ("content", "why"),
    [
        (b"nonsense", "is not a readable"),
        (encoded(np.zeros((6, 8), np.uint16))[:60], "no PNG of 16 bit"),
        (encoded(np.zeros((6, 8), np.uint8)), "no PNG of 16 bit"),
        (encoded(np.zeros((6, 9), np.uint16)), "is 9x6, the calibration is for 8x6"),
    ],
)
def test_a_depth_picture_that_cannot_be_used_is_named(content: bytes, why: str) -> None:
    with pytest.raises(DataError, match=rf"depth picture shelf\.png .*{why}"):
        DepthFrame(0, content, depth_camera(8, 6), "shelf.png").millimetres()


def test_a_damaged_picture_leaves_what_was_kept_in_order() -> None:
    log, good = DepthLog(), frames(depth_camera(), way())
    log.add(good[0])
    with pytest.raises(DataError):
        log.add(replace(good[1], encoded=b"no picture"))
    log.add(good[2])
    scans = log.scans()
    assert scans is not None
    assert scans.t_robot_ns.tolist() == [good[0].t_robot_ns, good[2].t_robot_ns] and len(scans.millimetres) == 2


@given(st.binary(max_size=300))
@example(encoded(np.zeros((6, 8), np.uint16)))
def test_any_bytes_are_a_picture_or_refused_in_words(content: bytes) -> None:
    frame = DepthFrame(0, content, depth_camera(8, 6))
    with contextlib.suppress(DataError):
        assert frame.millimetres().shape == (6, 8)


@given(st.data())
def test_a_damaged_picture_is_a_picture_or_refused_in_words(data: st.DataObject) -> None:
    content = bytearray(encoded(np.arange(48, dtype=np.uint16).reshape(6, 8)))
    for at in data.draw(st.lists(st.integers(0, len(content) - 1), min_size=1, max_size=4)):
        content[at] = data.draw(st.integers(0, 255))
    with contextlib.suppress(DataError):
        assert DepthFrame(0, bytes(content), depth_camera(8, 6)).millimetres().shape == (6, 8)
