import cv2
import numpy as np
import pytest

from shared.errors import ConfigError, EstimationError
from station.experiments.trajectory_error import absolute_trajectory_error, path_length
from station.model.frames import ImageFrame
from station.slam.backends import make_backend
from station.slam.run import run_backend
from tests.support.mono import hand_held_camera, hand_held_path, rendered

SEED, SECONDS = 1, 2.0


@pytest.fixture(scope="module")
def frames() -> list[ImageFrame]:
    return list(rendered(hand_held_path(SEED, SECONDS), hand_held_camera(), SEED))


def black(index: int, t_ns: int) -> ImageFrame:
    ok, encoded = cv2.imencode(".png", np.zeros((480, 640), np.uint8))
    assert ok
    return ImageFrame(index, t_ns, 0, encoded.tobytes())


def test_rendered_pictures_give_a_pose_each_and_a_map_of_arbitrary_scale(frames: list[ImageFrame]) -> None:
    updates = []
    nav = run_backend(make_backend("mono", hand_held_camera()), iter(frames), updates.append)
    assert [update.state for update in updates] == ["tracking"] * len(frames)
    assert all(update.T_world_body is not None and update.scale == "arbitrary" for update in updates)
    assert (nav.report.backend, nav.report.scale, nav.is_gravity_aligned) == ("mono", "arbitrary", False)
    assert nav.report.tracking_lost_s == 0.0 and len(nav.trajectory) == len(frames)
    truth = hand_held_path(SEED, SECONDS)
    assert absolute_trajectory_error(nav.trajectory, truth, "sim3").rmse_m < 0.05 * path_length(truth)
    assert len(nav.landmarks) >= 10 and nav.landmarks.num_observations.min() >= 3
    assert len(nav.keyframes) >= 2 and np.isfinite(nav.landmarks.p_world).all()


def test_same_pictures_give_the_same_bits(frames: list[ImageFrame]) -> None:
    ids = {run_backend(make_backend("mono", hand_held_camera()), iter(frames[:25])).id for _ in range(2)}
    assert len(ids) == 1


def test_covered_lens_is_said_to_lose_tracking_and_the_next_start_is_a_new_segment(frames: list[ImageFrame]) -> None:
    backend = make_backend("mono", hand_held_camera())
    t, step = [frame.t_robot_ns for frame in frames], 33_333_333
    first = frames[:15]
    dark = [black(15 + k, t[14] + (k + 1) * step) for k in range(20)]
    later = [ImageFrame(frame.index + 20, frame.t_robot_ns + 20 * step, 0, frame.encoded) for frame in frames[15:30]]
    for frame in first:
        before = backend.add_frame(frame)
    states = [backend.add_frame(frame).state for frame in dark]
    after = [backend.add_frame(frame) for frame in later]
    assert (before.state, before.segment, states[-1]) == ("tracking", 0, "lost")
    assert (after[-1].state, after[-1].segment) == ("tracking", 1)
    nav = backend.finish()
    assert sorted(set(nav.keyframes.segment.tolist())) == [0, 1]
    assert 0.6 < nav.report.tracking_lost_s < 0.8
    assert any("tracking lost" in message for message in nav.report.messages)


def test_pictures_without_corners_are_refused_with_the_reason() -> None:
    backend = make_backend("mono", hand_held_camera())
    assert backend.add_frame(black(0, 0)).state == "initialising"
    with pytest.raises(EstimationError, match="never started"):
        backend.finish()


def test_pictures_of_another_size_are_refused() -> None:
    backend = make_backend("mono", hand_held_camera())
    ok, encoded = cv2.imencode(".png", np.zeros((48, 64), np.uint8))
    assert ok
    with pytest.raises(ConfigError, match="64x48"):
        backend.add_frame(ImageFrame(0, 0, 0, encoded.tobytes()))
