"""What a calibration says of the robot, also one that was written before it could be asked."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest

from shared.calibration import REFERENCE_ROBOT, Calibration, Rig
from shared.errors import DataError
from shared.sensor_yaml import read_rig


@pytest.mark.parametrize(("kind", "has_wheels"), [("sentinel", True), ("generic", False), ("handheld rig", False)])
def test_the_kind_of_robot_in_recordings_and_hellos_says_whether_it_has_wheels(kind: str, has_wheels: bool) -> None:
    written = b'{"camera": null, "imu": null, "robot_kind": "%s"}' % kind.encode()
    assert msgspec.json.decode(written, type=Calibration).has_wheels is has_wheels


def test_a_calibration_of_no_known_robot_has_no_wheels() -> None:
    assert not msgspec.json.decode(b'{"camera": null, "imu": null}', type=Calibration).has_wheels


@pytest.mark.parametrize(("rig", "has_wheels"), [("wheels", True), ("hand-held", False), ("unknown", True)])
def test_what_carries_the_sensors_is_told_and_else_guessed_by_the_kind_of_robot(rig: Rig, has_wheels: bool) -> None:
    told = msgspec.structs.replace(REFERENCE_ROBOT, rig=rig)
    assert told.has_wheels is has_wheels
    assert msgspec.json.decode(msgspec.json.encode(told), type=Calibration) == told


def test_a_rig_nobody_heard_of_is_refused_by_its_name(tmp_path: Path) -> None:
    assert read_rig({}, tmp_path) == "unknown" and read_rig({"rig": "hand-held"}, tmp_path) == "hand-held"
    with pytest.raises(DataError, match="rig is 'boat'; write one of wheels, hand-held, unknown"):
        read_rig({"rig": "boat"}, tmp_path)
