"""Session rules: what is allowed when, and what silence means."""

from __future__ import annotations

import pytest

from shared.calibration import REFERENCE_ROBOT
from shared.errors import LocalProtocolError, RemoteProtocolError
from shared.messages import (
    PROTOCOL_VERSION,
    Capabilities,
    Drive,
    ErrorNotice,
    Heartbeat,
    Hello,
    Join,
    Message,
    Refusal,
    Stop,
    Welcome,
)
from shared.session import (
    CLOSE_AFTER_NS,
    HEARTBEAT_INTERVAL_NS,
    JOIN_WITHIN_NS,
    QUIET_AFTER_NS,
    ROBOT_RULES,
    STATION_RULES,
    Event,
    Session,
    State,
    Tick,
    reply_to,
)
from tests.support.paths import ROOT

MS = 1_000_000
CAPABILITIES = Capabilities(camera=True, imu=True, drive=True, pan_tilt=False, battery=False, hijack=False)


def hello(protocol: int = PROTOCOL_VERSION) -> Hello:
    return Hello(
        protocol=protocol,
        robot_id="r",
        name="R",
        session_id="s",
        capabilities=CAPABILITIES,
        calibration=REFERENCE_ROBOT,
    )


def join(protocol: int = PROTOCOL_VERSION) -> Join:
    return Join(protocol=protocol, station_name="desk")


def say(sender: Session, receiver: Session, message: Message, now_ns: int = 0) -> Message | None:
    receiver.receive(sender.send(message))
    return receiver.next_message(now_ns)


def joined_pair(now_ns: int = 0) -> tuple[Session, Session]:
    robot, station = Session("robot", now_ns), Session("station", now_ns)
    say(robot, station, hello(), now_ns)
    say(station, robot, join(), now_ns)
    say(robot, station, Welcome(client_id=1), now_ns)
    return robot, station


def tick_through(session: Session, begin_ns: int, end_ns: int, step_ns: int = 50 * MS) -> list[tuple[int, Tick]]:
    return [(t, duty) for t in range(begin_ns, end_ns + 1, step_ns) for duty in session.tick(t)]


def test_hello_join_welcome_makes_both_sides_active() -> None:
    robot, station = joined_pair()
    assert robot.state is station.state is State.ACTIVE


def test_refusal_closes_both_sides_with_its_reason() -> None:
    robot, station = Session("robot", 0), Session("station", 0)
    say(robot, station, hello())
    say(station, robot, join())
    say(robot, station, Refusal(reason="full"))
    assert robot.state is station.state is State.CLOSED
    assert robot.close_reason == "full"


@pytest.mark.parametrize("early", [Stop(seq=1), Heartbeat(seq=1, t_station_ns=0), join()])
def test_a_station_that_speaks_out_of_turn_is_refused(early: Message) -> None:
    _, other_station = joined_pair()
    robot, station = Session("robot", 0), Session("station", 0)
    say(robot, station, hello())
    say(station, robot, join())
    with pytest.raises(RemoteProtocolError, match="while the connection was joining"):
        say(other_station, robot, early)
    assert robot.state is State.CLOSED


def test_our_own_side_cannot_command_before_it_is_welcome() -> None:
    station = Session("station", 0)
    with pytest.raises(LocalProtocolError, match="while the connection is opening"):
        station.send(Stop(seq=1))


def test_another_version_is_named_on_both_sides() -> None:
    robot, station = Session("robot", 0), Session("station", 0)
    with pytest.raises(RemoteProtocolError, match=f"speaks protocol version {PROTOCOL_VERSION + 1}"):
        say(robot, station, hello(PROTOCOL_VERSION + 1))
    with pytest.raises(RemoteProtocolError, match=f"speaks protocol version {PROTOCOL_VERSION - 1}"):
        say(station, robot, join(PROTOCOL_VERSION - 1))


def test_a_fatal_notice_closes_and_another_does_not() -> None:
    robot, station = joined_pair()
    say(robot, station, ErrorNotice(code="device", message="camera gone"))
    assert station.state is State.ACTIVE
    say(robot, station, ErrorNotice(code="shutdown", message="bye", fatal=True))
    assert station.state is State.CLOSED


def test_the_last_word_can_be_said_after_closing() -> None:
    robot, _ = joined_pair()
    robot.close(Event.BROKE_RULES, "nonsense")
    assert robot.send(ErrorNotice(code="protocol", message="nonsense", fatal=True))


def test_a_stranger_who_never_joins_is_closed() -> None:
    robot = Session("robot", 0)
    assert tick_through(robot, 0, JOIN_WITHIN_NS) == [(JOIN_WITHIN_NS, Tick.CLOSE)]
    assert "3 s" in robot.close_reason


def test_silence_is_first_quiet_then_the_end() -> None:
    robot, _ = joined_pair()
    assert tick_through(robot, 0, CLOSE_AFTER_NS) == [(QUIET_AFTER_NS, Tick.WENT_QUIET), (CLOSE_AFTER_NS, Tick.CLOSE)]


def test_a_word_ends_the_quiet() -> None:
    robot, station = joined_pair()
    tick_through(robot, 0, QUIET_AFTER_NS)
    assert robot.state is State.QUIET
    say(station, robot, Heartbeat(seq=1, t_station_ns=5), QUIET_AFTER_NS)
    assert robot.state is State.ACTIVE


def test_trickling_bytes_is_silence() -> None:
    robot, station = joined_pair()
    message = station.send(Drive(seq=1, t_station_ns=0, linear=0.1, angular=0.0, ttl_ms=200))
    duties = []
    for count, t in enumerate(range(0, CLOSE_AFTER_NS + 1, 250 * MS)):
        robot.receive(message[count : count + 1] if count < len(message) - 1 else b"")
        assert robot.next_message(t) is None
        duties += robot.tick(t)
    assert duties == [Tick.WENT_QUIET, Tick.CLOSE]


def test_our_own_pause_is_not_the_peers_silence() -> None:
    robot, _ = joined_pair()
    robot.tick(0)
    assert robot.tick(60 * CLOSE_AFTER_NS) == []
    assert robot.state is State.ACTIVE


def test_a_word_that_is_read_behind_our_own_pause_is_of_now_and_not_of_later() -> None:
    robot, station = joined_pair()
    robot.tick(0)
    pause_ns = CLOSE_AFTER_NS // 2
    say(station, robot, Heartbeat(seq=1, t_station_ns=5), pause_ns)
    quiet, closed = (pause_ns + QUIET_AFTER_NS, Tick.WENT_QUIET), (pause_ns + CLOSE_AFTER_NS, Tick.CLOSE)
    assert tick_through(robot, pause_ns, 3 * CLOSE_AFTER_NS) == [quiet, closed]


def test_station_sends_heartbeats_only_once_joined() -> None:
    _, station = joined_pair()
    beats = [t for t, duty in tick_through(station, 0, 950 * MS) if duty is Tick.SEND_HEARTBEAT]
    assert beats == list(range(HEARTBEAT_INTERVAL_NS, 950 * MS, HEARTBEAT_INTERVAL_NS))
    waiting = Session("station", 0)
    assert Tick.SEND_HEARTBEAT not in [duty for _, duty in tick_through(waiting, 0, 950 * MS)]


def test_reply_carries_both_clocks() -> None:
    reply = reply_to(Heartbeat(seq=3, t_station_ns=7), received_ns=100, sent_ns=110)
    assert (reply.seq, reply.t_station_ns, reply.t_robot_received_ns, reply.t_robot_sent_ns) == (3, 7, 100, 110)


@pytest.mark.parametrize("rules", [ROBOT_RULES, STATION_RULES])
def test_every_state_can_be_left_and_reached(rules: dict[State, dict[Event, State]]) -> None:
    reached = {following for moves in rules.values() for following in moves.values()}
    assert set(rules) == set(State) == reached | {State.OPENING}
    for state, moves in rules.items():
        if state is not State.CLOSED:
            assert {Event.LOST, Event.TIMED_OUT, Event.BROKE_RULES} <= set(moves)


def diagram(rules: dict[State, dict[Event, State]]) -> str:
    """A Mermaid state diagram of one side's rules."""
    lines = ["stateDiagram-v2", "    [*] --> opening"]
    for state, moves in rules.items():
        reached: dict[State, list[str]] = {}
        for event, following in moves.items():
            reached.setdefault(following, []).append(event.value)
        lines += [f"    {state.value} --> {goal.value}: {', '.join(events)}" for goal, events in reached.items()]
    return "\n".join([*lines, "    closed --> [*]"])


@pytest.mark.parametrize("rules", [ROBOT_RULES, STATION_RULES])
def test_the_documented_diagram_is_the_table(rules: dict[State, dict[Event, State]]) -> None:
    page = (ROOT / "docs" / "protocol.md").read_text()
    assert f"```mermaid\n{diagram(rules)}\n```" in page, "put diagram(...) into docs/protocol.md again"
