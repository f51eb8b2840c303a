"""When the ukf backend gives tracking up, and when it does not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from shared.geometry import so3_exp
from station.slam.ukf.config import UkfConfig
from station.slam.ukf.filter.constraints import BodyVelocity
from station.slam.ukf.filter.filter import FrameResult
from station.slam.ukf.filter.state import FilterState, initial_state
from station.slam.ukf.monitor import TrackingMonitor
from station.vision.klt import TrackedFrame

FRAME_NS = 50_000_000
BRIGHT = 120.0


def result(observed: int, passed: int, tried: int, used: int, misfits: int = 0) -> FrameResult:
    none = np.zeros(0, dtype=np.int64)
    return FrameResult(0, 0.0, 1, observed, passed, observed, used, tried, misfits, none, none, ())


def view(num_tracked: int, brightness: float = BRIGHT) -> TrackedFrame:
    nothing = np.zeros((0, 2))
    return TrackedFrame(np.zeros(0, np.int64), nothing, nothing, num_tracked, brightness)


def resting() -> FilterState:
    return initial_state(0, np.eye(3), np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3), 0.1 * np.eye(15))


def rolling(sigma_m_s: float = 0.05) -> BodyVelocity:
    return BodyVelocity(np.array([0.3, 0.0, 0.0]), np.array([sigma_m_s, 0.05, 0.05]), np.zeros((3, 2)))


def lost_in(brightness: list[float], wheels: BodyVelocity | None = None) -> float | None:
    """Seconds until a robot on wheels is lost that sees nothing to follow, by the brightness of each image.

    Before them it sees a second of something to follow, of the first one's brightness.
    """
    monitor, none, wheels = TrackingMonitor(UkfConfig()), result(0, 0, 0, 0), wheels or rolling()
    for k in range(-20, 0):
        assert monitor.why_lost(resting(), view(80, brightness[0]), k * FRAME_NS, wheels, none) is None
    for k, light in enumerate(brightness):
        if monitor.why_lost(resting(), view(0, light), k * FRAME_NS, wheels, none) is not None:
            return k * FRAME_NS * 1e-9
    return None


def seconds_until_lost(
    results: FrameResult,
    state: FilterState,
    num_tracked: int = 80,
    brightness: float = BRIGHT,
    has_wheels: bool = False,
    limit: int = 400,
) -> float | None:
    """After an image with something to follow."""
    monitor = TrackingMonitor(UkfConfig())
    wheels = rolling() if has_wheels else None
    assert monitor.why_lost(resting(), view(80), -FRAME_NS, wheels, result(0, 0, 0, 0)) is None
    for k in range(limit):
        if monitor.why_lost(state, view(num_tracked, brightness), k * FRAME_NS, wheels, results) is not None:
            return k * FRAME_NS * 1e-9
    return None


@pytest.mark.parametrize(
    "sound",
    [
        result(30, 29, 10, 9),
        result(30, 20, 10, 6, misfits=2),  # somebody walks through the picture
        result(0, 0, 0, 0),  # a blank wall
    ],
)
def test_tracking_goes_on_while_most_measurements_fit(sound: FrameResult) -> None:
    assert seconds_until_lost(sound, resting()) is None


def test_a_few_tracks_that_do_not_fit_are_no_reason() -> None:
    assert seconds_until_lost(result(2, 0, 1, 0), resting(), limit=8) is None


@pytest.mark.parametrize("wrong", [result(20, 3, 5, 0), result(0, 0, 8, 2), result(0, 0, 0, 0, misfits=10)])
def test_a_camera_that_seldom_fits_is_given_up_within_two_seconds(wrong: FrameResult) -> None:
    lost_s = seconds_until_lost(wrong, resting())
    assert lost_s is not None and lost_s <= 2.0


def test_on_wheels_a_blank_wall_is_borne_and_a_covered_lens_is_not() -> None:
    nothing, config = result(0, 0, 0, 0), UkfConfig()
    flown_s = seconds_until_lost(nothing, resting(), num_tracked=0)
    wall_s = seconds_until_lost(nothing, resting(), num_tracked=0, brightness=0.5 * BRIGHT, has_wheels=True)
    covered_s = seconds_until_lost(nothing, resting(), num_tracked=0, brightness=0.2 * BRIGHT, has_wheels=True)
    assert flown_s == pytest.approx(config.max_outage_s + 0.05, abs=0.051)
    assert wall_s == pytest.approx(config.max_outage_wheels_s + 0.05, abs=0.051)
    assert covered_s is not None and covered_s <= 2.0


def test_somebodys_dark_legs_before_a_wall_are_no_cover() -> None:
    wall = [BRIGHT] * 40
    assert lost_in([*wall, 0.25 * BRIGHT, *wall, 0.2 * BRIGHT, 0.2 * BRIGHT, *wall]) is None


def test_a_cover_stays_one_while_exposure_makes_up_for_it() -> None:
    # Twelve per cent more in each image, until it is as bright as before: a second.
    covered = [min(0.15 * 1.12**k, 1.0) * BRIGHT for k in range(80)]
    lost_s = lost_in([BRIGHT] * 10 + covered)
    assert lost_s == pytest.approx(0.5 + UkfConfig().max_covered_s + 0.05, abs=0.051)


def test_a_shaded_wall_that_one_turns_to_is_no_cover() -> None:
    # A window of 180 leaves the picture within a second; the wall beside it is at 45.
    assert lost_in([180.0 - 135.0 * min(k / 20, 1.0) for k in range(100)]) is None


def test_wheels_that_do_not_say_how_fast_they_turn_carry_nobody() -> None:
    config = UkfConfig()
    lost_s = lost_in([BRIGHT] * 100, rolling(sigma_m_s=np.inf))
    assert lost_s == pytest.approx(config.max_outage_s + 0.05, abs=0.051)


def test_a_robot_that_rises_or_tilts_is_lifted_and_a_drone_is_not() -> None:
    fine = result(30, 30, 5, 5)
    rising = replace(resting(), v=np.array([0.0, 0.0, 0.4]))
    tilted = replace(resting(), R=so3_exp(np.array([0.25, 0.0, 0.0])))
    for state in (rising, tilted):
        assert seconds_until_lost(fine, state, has_wheels=True) == pytest.approx(0.1)
        assert seconds_until_lost(fine, state, has_wheels=False) is None


def test_nonsense_is_given_up_at_once() -> None:
    fine = result(30, 30, 5, 5)
    assert seconds_until_lost(fine, replace(resting(), x=np.array([np.nan, 0.0, 0.0]))) == 0.0
    assert seconds_until_lost(fine, replace(resting(), v=np.array([40.0, 0.0, 0.0]))) == 0.0
