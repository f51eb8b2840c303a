"""When a station believes that a robot does not hear it: not from what a stall of the network held back."""

from __future__ import annotations

from shared.messages import DriveApplied, HeartbeatReply, Welcome
from station.robots.link import UNHEARD_AFTER_NS, UNHEARD_FOR_NS, RobotLink
from tests.support.link import Notes

SECOND = 1_000_000_000


def test_a_burst_after_a_stall_is_no_sign_but_a_robot_that_speaks_on_without_answering_is() -> None:
    link = RobotLink("127.0.0.1", 1, Notes())
    now = 100 * SECOND
    link._take(Welcome(client_id=1), now)
    now += 5 * SECOND  # a stall; then everything at once, the answers to heartbeats last
    for k in range(40):
        link._take(DriveApplied(t_robot_ns=k, linear=0.0, angular=0.0), now)
    assert not link._is_unheard(now + UNHEARD_FOR_NS // 2)
    link._take(HeartbeatReply(seq=1, t_station_ns=now, t_robot_received_ns=now, t_robot_sent_ns=now), now)
    for k in range(40):
        link._take(DriveApplied(t_robot_ns=k, linear=0.0, angular=0.0), now + UNHEARD_AFTER_NS + k)
    assert link._is_unheard(now + UNHEARD_AFTER_NS + UNHEARD_FOR_NS)
