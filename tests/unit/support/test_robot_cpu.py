"""A measurement on a PC that was too busy is no measurement."""

from tests.support.robot_cpu import starved


def test_too_few_frames_are_named() -> None:
    result = {"idle": {"frames_per_s": 29.9}, "driven": {"frames_per_s": 11.0}, "jpeg": 3.0, "first": {"imu_lost": 0}}
    assert starved(result) == ["driven"]
