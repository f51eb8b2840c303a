"""What the person who waves the robot before a board is told, from the board in its pictures alone."""

from __future__ import annotations

from dataclasses import replace

from station.calibration.camera_imu.guide import WavingGuide
from station.calibration.guidance import Guidance
from tests.support.calibration_sessions import Waving, make_session


def followed(waving: Waving, duration_s: float = 36.0) -> Guidance:
    """What is said at the end of a recording of five pictures a second."""
    session = make_session(6, duration_s=duration_s, frame_rate_hz=5.0, waving=waving)
    guide = WavingGuide(session.target, session.camera)
    said = guide.look(None)
    for view in session.views:
        said = guide.look(view)
    return said


LIVELY = Waving(turn_rad=(0.2, 0.2, 0.25), distance_swing_m=0.08, slowest_hz=0.15, fastest_hz=0.5)


def test_who_waves_about_all_axes_for_half_a_minute_is_told_that_it_is_enough() -> None:
    said = followed(LIVELY)
    assert said.is_enough and said.instruction.startswith("enough"), said


def test_the_turn_that_is_missing_is_named() -> None:
    said = followed(replace(LIVELY, turn_rad=(0.2, 0.0, 0.25), shake_m=0.002))
    assert not said.is_enough
    assert said.poses["turn"] < 0.8 and said.poses["tilt"] == said.poses["roll"] == 1.0, said
    assert "left and right" in said.instruction


def test_a_robot_held_still_is_told_to_move_whatever_the_time() -> None:
    said = followed(Waving((0.0, 0.0, 0.0), shake_m=0.0, distance_swing_m=0.0))
    assert said.poses.pop("time") == 1.0 and max(said.poses.values()) < 0.2, said
    assert said.instruction == "move it nearer and farther"


def test_a_board_out_of_view_is_asked_for_and_its_time_does_not_count() -> None:
    session = make_session(6, duration_s=4.0, frame_rate_hz=5.0)
    guide = WavingGuide(session.target, session.camera)
    for view in session.views[:5]:
        guide.look(view)
    before = guide.look(None)
    assert "in view" in before.instruction and not before.is_taken
    late = session.views[-1]
    after = guide.look(replace(late, t_robot_ns=late.t_robot_ns + 60_000_000_000))
    assert after.poses["time"] == before.poses["time"]
