"""The smoothing backend on short simulated drives: a head that turns, images that fail."""

from __future__ import annotations

from dataclasses import replace
from typing import SupportsIndex, SupportsInt

import gtsam
import numpy as np
import pytest

from shared.calibration import ImuNoise
from shared.geometry import FloatArray, inverse
from station.model.frames import ImageFrame
from station.model.navigation import Navigation
from station.model.slam_update import SlamUpdate
from station.motion.preintegration import ImuSegment, Preintegration, preintegrate
from station.slam.backends import make_backend
from station.slam.run import run_backend
from station.slam.smoothing.config import SmoothingConfig
from station.slam.smoothing.fixed_lag import FixedLagWindow
from station.slam.ukf.backend import UkfBackend
from tests.support.drives.short import CALIBRATION, ShortDrive, drive

pytestmark = pytest.mark.computing


def run(name: str, wanted: ShortDrive) -> tuple[Navigation, list[SlamUpdate]]:
    updates: list[SlamUpdate] = []
    return run_backend(make_backend(name, CALIBRATION), drive(wanted), updates.append), updates


def test_of_a_head_that_turned_the_result_is_the_filters_and_the_report_says_so() -> None:
    wanted = ShortDrive(end_s=3.6, head_s=1.2)
    nav, updates = run("smoothing", wanted)
    of_filter, live = run("ukf", wanted)
    assert np.array_equal(nav.trajectory.T_world_body, of_filter.trajectory.T_world_body)
    assert np.array_equal(nav.landmarks.p_world, of_filter.landmarks.p_world)
    for mine, theirs in zip(updates, live, strict=True):
        if theirs.T_world_body is not None and theirs.t_robot_ns > 2.4e9:
            assert mine.T_world_body is not None
            assert np.array_equal(mine.T_world_body, theirs.T_world_body)
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
        points = np.array([[1.0, 2.0, 0.5], [-3.0, 1.0, 1.0]])  # so short a drive gives no new ones by itself
        of_filter.append(replace(add_frame(backend, frame), new_points_world=points))
        return of_filter[-1]

    monkeypatch.setattr(UkfBackend, "add_frame", watched)
    _, updates = run("smoothing", ShortDrive(end_s=4.5, spoilt_image=45))
    before, spoilt = updates[44].T_world_body, updates[45].T_world_body
    filters = of_filter[45].T_world_body
    assert before is not None and spoilt is not None and filters is not None
    assert np.array_equal(before, spoilt)
    assert np.abs(spoilt - filters).max() > 1e-4  # else nothing is told apart
    moved_m = []
    for mine, theirs in zip(updates, of_filter, strict=True):
        if theirs.T_world_body is None:
            continue
        assert mine.T_world_body is not None
        assert mine.new_points_world is not None and theirs.new_points_world is not None
        T = mine.T_world_body @ inverse(theirs.T_world_body)
        expected = theirs.new_points_world @ T[:3, :3].T + T[:3, 3]
        assert np.allclose(mine.new_points_world, expected, atol=1e-9)
        moved_m.append(float(np.abs(expected - theirs.new_points_world).max()))
    assert max(moved_m) > 1e-4
