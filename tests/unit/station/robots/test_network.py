"""The network's state in words, and what a slow one gives to a command's time to live."""

from __future__ import annotations

import pytest

from shared.messages import MAX_DRIVE_TTL_MS, Capabilities, Drive
from station.robots.link_commands import DueMessages, LinkCommands
from station.robots.network import OwnPauses, RecentDelays

MS = 1_000_000


def delays(trip_ms: int, age_ms: int | None) -> RecentDelays:
    found = RecentDelays()
    for _ in range(20):
        found.add_round_trip(trip_ms * MS)
        if age_ms is not None:
            found.add_picture(age_ms * MS)
    return found


@pytest.mark.parametrize(
    ("trip_ms", "age_ms", "rate_hz", "grade", "words"),
    [
        (5, 60, 30.0, "good", "the network is good"),
        (5, None, 0.0, "good", "the network is good"),  # a robot without camera
        (
            80,
            200,
            9.0,
            "slow",
            "slow network: 9 pictures a second, 200 ms old, 80 ms there and back; drive slowly",
        ),
        (5, 60, 4.0, "slow", "slow network: 4 pictures a second, 60 ms old, 5 ms there and back; drive slowly"),
        (300, None, 0.0, "slow", "slow network: 300 ms there and back; drive slowly"),
        (
            350,
            210,
            15.0,
            "bad",
            "bad network: 15 pictures a second, 210 ms old, 350 ms there and back;"
            " the robot stands, since stops would come too late; come closer to the access point",
        ),
        (
            700,
            900,
            1.6,
            "bad",
            "bad network: 2 pictures a second, 900 ms old, 700 ms there and back;"
            " the robot stands, since stops would come too late; come closer to the access point",
        ),
        (
            300,
            900,
            1.6,
            "bad",
            "bad network: 2 pictures a second, 900 ms old, 300 ms there and back; come closer to the access point",
        ),
    ],
)
def test_the_networks_state_in_words(trip_ms: int, age_ms: int | None, rate_hz: float, grade: str, words: str) -> None:
    state = delays(trip_ms, age_ms).state(rate_hz, is_quiet=False)
    assert (state.grade, state.sentence) == (grade, words)


@pytest.mark.parametrize(
    ("trip_ms", "age_ms", "rate_hz", "words"),
    [
        (5, 60, 30.0, "the network is good"),
        (80, 200, 9.0, "this computer is busy: 9 pictures a second, 200 ms old, 80 ms there and back; drive slowly"),
        (
            700,
            900,
            1.6,
            "this computer is too busy: 2 pictures a second, 900 ms old, 700 ms there and back;"
            " the robot stands, since stops would come too late; let it do less",
        ),
    ],
)
def test_no_network_is_blamed_where_robot_and_station_are_one_machine(
    trip_ms: int, age_ms: int, rate_hz: float, words: str
) -> None:
    assert delays(trip_ms, age_ms).state(rate_hz, is_quiet=False, is_same_machine=True).sentence == words


@pytest.mark.parametrize(
    ("own_ms", "sentence", "is_busy"),
    [
        (
            200,
            "the station's computer is busy: 9 pictures a second, 300 ms old, 50 ms there and back; drive slowly",
            True,
        ),
        (100, "slow network: 9 pictures a second, 300 ms old, 50 ms there and back; drive slowly", False),
    ],
)
def test_the_computer_is_blamed_where_its_own_pauses_took_most_of_the_time(
    own_ms: int, sentence: str, is_busy: bool
) -> None:
    found = RecentDelays()
    for _ in range(20):
        found.add_round_trip(50 * MS)
        found.add_picture(300 * MS, own_ms * MS)
    state = found.state(9.0, is_quiet=False)
    assert (state.sentence, state.computer_busy) == (sentence, is_busy)


def test_pauses_are_the_time_behind_what_was_due_also_before_their_end_is_noted() -> None:
    pauses = OwnPauses()
    pauses.expect(25)
    assert pauses.within_ns(0, 20) == 0
    assert pauses.within_ns(0, 125) == 100  # a picture that waited is read before the program notes that it is late
    pauses.note(135)
    assert pauses.within_ns(0, 200) == 110
    assert pauses.within_ns(100, 200) == 35
    assert pauses.within_ns(140, 200) == 0
    pauses.expect(225)
    pauses.note(225)
    assert pauses.within_ns(140, 300) == 0


def test_a_silent_robot_is_no_good_network_whatever_came_before() -> None:
    assert delays(5, 60).state(30.0, is_quiet=True).grade == "silent"


def test_one_late_heartbeat_in_twenty_is_no_slow_network() -> None:
    found = delays(5, 60)
    found.add_round_trip(2000 * MS)
    assert found.state(30.0, is_quiet=False).grade == "good"


def sent_ttl_ms(found: RecentDelays, asked_ms: int) -> int:
    due = DueMessages()
    commands = LinkCommands(due, lambda: 0, late_ms=lambda: found.late_ms)
    able = Capabilities(camera=True, imu=True, drive=True, pan_tilt=False, battery=False, hijack=False)
    commands.open(able)
    assert commands.drive(0.1, 0.0, asked_ms)
    message = due.pop()
    assert isinstance(message, Drive)
    return message.ttl_ms


def test_a_command_lives_longer_where_the_network_is_late_and_never_beyond_the_limit() -> None:
    quick, late = delays(20, None), delays(20, None)
    for _ in range(20):
        late.add_round_trip(50 * MS)
    assert sent_ttl_ms(quick, 200) == 200
    assert sent_ttl_ms(late, 200) == 230
    for _ in range(20):
        late.add_round_trip(900 * MS)
    assert sent_ttl_ms(late, 200) == MAX_DRIVE_TTL_MS
