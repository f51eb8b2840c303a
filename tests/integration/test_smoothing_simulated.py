"""The smoothing backend on short simulated drives: a head that turns, images that fail."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cache
from typing import SupportsIndex, SupportsInt, cast

import gtsam
import numpy as np
import pytest

from robot.simulation.worlds import make_world
from shared.calibration import ImuNoise
from shared.geometry import FloatArray, inverse
from station.model.frames import DriveSample, ImageFrame, ImuBatch
from station.model.navigation import Navigation
from station.model.slam_update import SlamUpdate
from station.motion.preintegration import ImuSegment, Preintegration, preintegrate
from station.slam.backends import make_backend
from station.slam.run import run_backend
from station.slam.smoothing.backend import SmoothingBackend
from station.slam.smoothing.closing import Claim
from station.slam.smoothing.config import SmoothingConfig
from station.slam.smoothing.fixed_lag import FixedLagWindow
from station.slam.ukf.backend import UkfBackend
from station.slam.ukf.map.views import MapViews
from tests.support.drives.short import CALIBRATION, ShortDrive, drive

pytestmark = pytest.mark.computing
POINTS = np.array([[1.0, 2.0, 0.5], [-3.0, 1.0, 1.0]])  # new ones: so short a drive gives none by itself


def run(name: str, wanted: ShortDrive) -> tuple[Navigation, list[SlamUpdate]]:
    updates: list[SlamUpdate] = []
    return run_backend(make_backend(name, CALIBRATION), drive(wanted), updates.append), updates


def poses(updates: list[SlamUpdate], after_ns: float = 0.0) -> FloatArray:
    """(N, 4, 4) of the frames that have one."""
    return np.array([u.T_world_body for u in updates if u.T_world_body is not None and u.t_robot_ns > after_ns])


def test_of_a_head_that_turned_the_result_is_the_filters_and_the_report_says_so() -> None:
    wanted = ShortDrive(end_s=3.6, head_s=1.2)
    nav, updates = run("smoothing", wanted)
    of_filter, live = run("ukf", wanted)
    assert np.array_equal(nav.trajectory.T_world_body, of_filter.trajectory.T_world_body)
    assert np.array_equal(nav.landmarks.p_world, of_filter.landmarks.p_world)
    late, of_filter_late = poses(updates, after_ns=2.4e9), poses(live, after_ns=2.4e9)
    assert len(late) > 10 and np.array_equal(late, of_filter_late)
    assert any("head turned" in message for message in nav.report.messages)
    assert nav.report.backend == "smoothing"


def test_over_a_gap_between_images_every_imu_sample_is_integrated(monkeypatch: pytest.MonkeyPatch) -> None:
    longest_s: list[float] = []
    duration_s: list[float] = []

    def watched(segment: ImuSegment, bias: FloatArray, noise: ImuNoise) -> Preintegration:
        longest_s.append(float(segment.dt_s.max()))
        duration_s.append(float(segment.dt_s.sum()))
        return preintegrate(segment, bias, noise)

    monkeypatch.setattr("station.slam.smoothing.backend.preintegrate", watched)
    nav, updates = run("smoothing", ShortDrive(end_s=8.0, stop_s=2.0, no_images_s=(3.0, 7.5)))
    assert not any("lost" in message for message in nav.report.messages)
    assert updates[-1].state == "tracking"
    assert max(duration_s) > 4.0  # the link over the gap
    assert max(longest_s) < 0.01
    assert nav.report.config["smoothing"]["lag_s"] == SmoothingConfig().lag_s
    assert nav.report.config["mapped_from"] == "tracks" and "filter" in nav.report.config
    assert nav.report.versions["gtsam"]


def test_a_window_that_cannot_be_solved_begins_anew_and_the_report_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    make, made = FixedLagWindow._new_smoother, 0

    class FailsOnce:
        def __init__(self, smoother: gtsam.IncrementalFixedLagSmoother) -> None:
            self._smoother, self._updates = smoother, 0

        def __getattr__(self, name: str) -> object:
            return getattr(self._smoother, name)

        def update(
            self,
            graph: gtsam.NonlinearFactorGraph,
            values: gtsam.Values,
            times: dict[SupportsInt | SupportsIndex, float],
        ) -> None:
            self._updates += 1
            if self._updates == 5:
                raise RuntimeError("indeterminate")
            self._smoother.update(graph, values, times)

    def new_smoother(window: FixedLagWindow) -> object:
        nonlocal made
        made += 1
        return FailsOnce(make(window)) if made == 1 else make(window)

    monkeypatch.setattr(FixedLagWindow, "_new_smoother", new_smoother)
    nav, updates = run("smoothing", ShortDrive(end_s=4.0))
    assert updates[-1].state == "tracking"
    assert any(message.startswith("1 windows of keyframes begun anew") for message in nav.report.messages)


def test_a_spoilt_image_and_new_points_keep_to_the_smoothed_way(monkeypatch: pytest.MonkeyPatch) -> None:
    of_filter: list[SlamUpdate] = []
    add_frame = UkfBackend.add_frame

    def watched(backend: UkfBackend, frame: ImageFrame) -> SlamUpdate:
        of_filter.append(replace(add_frame(backend, frame), new_points_world=POINTS))
        return of_filter[-1]

    monkeypatch.setattr(UkfBackend, "add_frame", watched)
    _, updates = run("smoothing", ShortDrive(end_s=4.5, spoilt_image=46))
    before, spoilt, of_filter_spoilt = poses([updates[45], updates[46], of_filter[46]])
    assert np.allclose(before, spoilt, rtol=0.0, atol=1e-12)
    assert np.abs(spoilt - of_filter_spoilt).max() > 1e-4  # else nothing is told apart
    followed = [k for k, update in enumerate(of_filter) if update.T_world_body is not None]
    smoothed, filtered = poses([updates[k] for k in followed]), poses([of_filter[k] for k in followed])
    assert len(smoothed) == len(followed) > 10
    carried = np.array([updates[k].new_points_world for k in followed])
    T = smoothed @ inverse(filtered)
    expected = POINTS @ np.swapaxes(T[:, :3, :3], 1, 2) + T[:, None, :3, 3]
    assert np.allclose(carried, expected, atol=1e-9)
    assert np.abs(expected - POINTS).max() > 1e-4


@cache
def circle() -> list[ImuBatch | DriveSample | ImageFrame]:
    """Once around in 11 s, and a third of it again."""
    x, y, yaw = make_world("room", 0).start
    return list(drive(ShortDrive(end_s=16.0, turn_rad_s=1.5, world="room", start=(x, y, yaw + 1.2))))


def feed(backend: SmoothingBackend, events: Iterable[ImuBatch | DriveSample | ImageFrame]) -> Iterator[SlamUpdate]:
    """What each frame tells."""
    for event in events:
        if isinstance(event, ImageFrame):
            yield backend.add_frame(event)
        elif isinstance(event, DriveSample):
            backend.add_drive(event)
        else:
            backend.add_imu(event)


@dataclass(frozen=True, slots=True)
class Circled:
    """The loops closed on the circle, and what was told of each frame; where loops are closed, the views by then."""

    closed: list[Claim]
    updates: list[SlamUpdate]
    views: list[list[int]]


@cache
def twice_around(closes: bool) -> Circled:
    backend = SmoothingBackend(CALIBRATION, SmoothingConfig(closes_loops=closes))
    updates, views = list[SlamUpdate](), list[list[int]]()
    for update in feed(backend, circle()):
        updates.append(update)
        views.append(chosen(backend) if closes else [])
    assert (backend._closer is not None) == closes
    return Circled([] if backend._closer is None else list(backend._closer.closed.values()), updates, views)


def test_a_circle_driven_again_closes_loops_in_the_map() -> None:
    circled = twice_around(closes=True)
    updates = circled.updates
    assert len(circled.closed) > 3
    for loop in circled.closed:  # in a quarter of a minute the odometry drifts by millimetres
        before, after = poses([updates[loop.old], updates[loop.new]])
        assert np.abs((inverse(before) @ after)[:3, 3] - loop.T_old_new[:3, 3]).max() < 0.05
    correction = np.array([update.T_map_world for update in updates])
    assert np.array_equal(correction[100], np.eye(4))
    assert 1e-6 < np.abs(correction[-1] - np.eye(4)).max() < 0.05


def test_the_odometry_knows_nothing_of_loops() -> None:
    assert np.array_equal(poses(twice_around(closes=True).updates), poses(twice_around(closes=False).updates))


def test_idle_moments_spare_frames_the_window_and_change_no_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    solve, in_frame, solved = FixedLagWindow.solve, False, list[bool]()

    def watched(window: FixedLagWindow) -> bool:
        solved.append(in_frame)
        return solve(window)

    monkeypatch.setattr(FixedLagWindow, "solve", watched)
    ways = list[FloatArray]()
    for is_idle in (False, True):
        backend, way = SmoothingBackend(CALIBRATION), list[SlamUpdate]()
        in_frame = True
        solved.clear()
        for update in feed(backend, drive(ShortDrive(end_s=4.0))):
            way.append(update)
            in_frame = not is_idle
            while is_idle and backend.catch_up():
                pass
            in_frame = True
        assert len(solved) > 5 and all(solved) != is_idle
        ways.append(poses(way))
    assert sum(solved) < 3  # of the first frames, which are keyframes at once
    assert np.array_equal(ways[0], ways[1])


def chosen(backend: SmoothingBackend) -> list[int]:
    """Frame indices of its views."""
    return cast(MapViews, backend._odometry.memory.views).chosen_after(-1)


def test_where_loops_are_closed_a_keyframe_is_a_view_at_once() -> None:
    """The filter would give it away when it has seventeen newer ones, seconds later."""
    circled = twice_around(closes=True)
    waited = [
        frame - circled.views[frame][-1]
        for frame, update in enumerate(circled.updates)
        if update.state == "tracking" and update.t_robot_ns > 3e9
    ]
    views = np.array(circled.views[-1])
    assert len(views) > 20 and max(waited) <= np.diff(views).max() + 1


@pytest.mark.parametrize("is_lost", [False, True])
def test_what_was_seen_in_a_blind_while_is_a_view_once_that_has_ended_well(
    monkeypatch: pytest.MonkeyPatch, is_lost: bool
) -> None:
    backend = SmoothingBackend(CALIBRATION, SmoothingConfig(closes_loops=True))
    before, keyframes = list[int](), list[int]()
    for frame, _ in enumerate(feed(backend, circle())):
        if frame == 45:
            before = chosen(backend)
            monkeypatch.setattr(UkfBackend, "is_blind", True)
        if frame == 60:
            assert chosen(backend) == before
            keyframes = [k.source.frame.index for k in backend._keyframes]
            if is_lost:
                backend._end_window()
                backend._odometry.memory.recent = {}  # as where the filter loses track
            monkeypatch.setattr(UkfBackend, "is_blind", False)
        if frame == 66:
            break
    seen_blind = [frame for frame in chosen(backend) if 45 < frame <= 60]
    assert any(45 < frame <= 60 for frame in keyframes)
    assert not seen_blind if is_lost else seen_blind


def test_views_that_loops_wanted_are_the_filters_once_a_head_has_turned() -> None:
    wanted = ShortDrive(end_s=3.6, head_s=1.6)
    backend = SmoothingBackend(CALIBRATION, SmoothingConfig(closes_loops=True))
    next(update for update in feed(backend, drive(wanted)) if backend._head_turned)
    filtered = {k.image.index for k in backend._odometry.memory.keyframes.items}
    assert backend._odometry.memory.chooses_views and set(chosen(backend)) <= filtered
