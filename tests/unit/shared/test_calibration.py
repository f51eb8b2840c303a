"""What a calibration says of the robot, also one that was written before it could be asked."""

from __future__ import annotations

import msgspec
import pytest

from shared.calibration import REFERENCE_ROBOT, Calibration


@pytest.mark.parametrize(("kind", "has_wheels"), [("sentinel", True), ("generic", False), ("handheld rig", False)])
def test_the_kind_of_robot_in_recordings_and_hellos_says_whether_it_has_wheels(kind: str, has_wheels: bool) -> None:
    written = b'{"camera": null, "imu": null, "robot_kind": "%s"}' % kind.encode()
    assert msgspec.json.decode(written, type=Calibration).has_wheels is has_wheels


def test_a_calibration_of_no_known_robot_has_no_wheels() -> None:
    assert not msgspec.json.decode(b'{"camera": null, "imu": null}', type=Calibration).has_wheels


def test_asking_for_wheels_adds_nothing_to_what_is_written() -> None:
    assert set(msgspec.to_builtins(REFERENCE_ROBOT)) == {"camera", "imu", "robot_kind", "gravity"}
