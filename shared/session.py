"""Rules of one connection: who says what when, and what silence means. No socket, no thread, no clock.

`docs/protocol.md` shows the tables below as diagrams; a test keeps them current.
"""

from __future__ import annotations

from enum import Enum
from typing import Literal

from shared.errors import LocalProtocolError, RemoteProtocolError
from shared.framing import MAX_ROBOT_PAYLOAD, MAX_STATION_PAYLOAD, FrameDecoder, encode_payload
from shared.message_codec import decode_robot_message, decode_station_message, encode_message, version_mismatch
from shared.messages import (
    PROTOCOL_VERSION,
    ErrorNotice,
    Heartbeat,
    HeartbeatReply,
    Hello,
    Join,
    Message,
    Paired,
    PairProof,
    PairReply,
    PairRequest,
    Prove,
    Refusal,
    Welcome,
)

HEARTBEAT_INTERVAL_NS = 100_000_000
JOIN_WITHIN_NS = 3_000_000_000  # a stranger may hold a place in the hall for so long
QUIET_AFTER_NS = 1_000_000_000  # ten heartbeats missing: the station no longer drives
CLOSE_AFTER_NS = 10_000_000_000  # Wi-Fi comes back from a roam or a microwave oven within seconds
MESSAGES_AT_A_TIME = 16  # of one peer, then it is others' turn: who talks without end must keep nobody from STOP
OWN_PAUSE_NS = 500_000_000  # a longer pause between ticks was ours: what the peer said meanwhile is not read yet


class State(Enum):
    """Where a connection stands, as one side sees it."""

    OPENING = "opening"  # robot: hello sent; station: waiting for it
    JOINING = "joining"  # the station has sent its join, the robot has not answered yet
    PAIRING = "pairing"  # instead of joining: a code is exchanged for a token, then the connection ends
    ACTIVE = "active"
    QUIET = "quiet"  # joined, but nothing was heard for QUIET_AFTER_NS
    CLOSED = "closed"


class Event(Enum):
    """What moves a connection from state to state."""

    HELLO = "hello"
    PROOF = "proof"  # of a token, where the hello asks for one
    PAIR = "pair request or reply"
    PAIR_PROOF = "pair proof"
    PAIRED = "paired"
    JOIN = "join"
    WELCOME = "welcome"
    REFUSAL = "refusal"
    MESSAGE = "other message"
    FATAL_ERROR = "fatal error notice"
    WENT_QUIET = "quiet for 1 s"
    TIMED_OUT = "silent too long"
    BROKE_RULES = "peer broke the rules"
    LOST = "connection lost"


_ENDS = dict.fromkeys((Event.FATAL_ERROR, Event.TIMED_OUT, Event.BROKE_RULES, Event.LOST), State.CLOSED)

ROBOT_RULES: dict[State, dict[Event, State]] = {
    State.OPENING: {
        Event.PROOF: State.OPENING,
        Event.JOIN: State.JOINING,
        Event.PAIR: State.PAIRING,
        Event.REFUSAL: State.CLOSED,
        **_ENDS,
    },
    State.PAIRING: {
        Event.PAIR_PROOF: State.PAIRING,
        Event.PAIRED: State.CLOSED,
        Event.REFUSAL: State.CLOSED,
        **_ENDS,
    },
    State.JOINING: {Event.WELCOME: State.ACTIVE, Event.REFUSAL: State.CLOSED, **_ENDS},
    State.ACTIVE: {Event.MESSAGE: State.ACTIVE, Event.WENT_QUIET: State.QUIET, **_ENDS},
    State.QUIET: {Event.MESSAGE: State.ACTIVE, **_ENDS},
    State.CLOSED: {},
}
STATION_RULES: dict[State, dict[Event, State]] = {
    State.OPENING: {Event.HELLO: State.JOINING, Event.REFUSAL: State.CLOSED, **_ENDS},
    State.JOINING: {Event.WELCOME: State.ACTIVE, Event.PAIR: State.PAIRING, Event.REFUSAL: State.CLOSED, **_ENDS},
    State.PAIRING: {Event.PAIRED: State.CLOSED, Event.REFUSAL: State.CLOSED, **_ENDS},
    State.ACTIVE: {Event.MESSAGE: State.ACTIVE, Event.WENT_QUIET: State.QUIET, **_ENDS},
    State.QUIET: {Event.MESSAGE: State.ACTIVE, **_ENDS},
    State.CLOSED: {},
}
_EVENT_OF: dict[type, Event] = {
    Hello: Event.HELLO,
    Join: Event.JOIN,
    Welcome: Event.WELCOME,
    Refusal: Event.REFUSAL,
    Prove: Event.PROOF,
    PairRequest: Event.PAIR,
    PairReply: Event.PAIR,
    PairProof: Event.PAIR_PROOF,
    Paired: Event.PAIRED,
}
_JOINED = (State.ACTIVE, State.QUIET)


class Tick(Enum):
    """What the passing of time asks for."""

    SEND_HEARTBEAT = "send a heartbeat"  # station only
    WENT_QUIET = "the peer went quiet"
    CLOSE = "close the connection"


class Session:
    """One side of a connection: bytes and time in, messages and duties out."""

    def __init__(self, role: Literal["robot", "station"], now_ns: int, *, join_within_ns: int | None = None) -> None:
        """`join_within_ns`: the longest silence before the connection has joined; None: JOIN_WITHIN_NS."""
        self._join_within_ns = join_within_ns
        self._is_robot = role == "robot"
        self._peer = "station" if self._is_robot else "robot"
        self._rules = ROBOT_RULES if self._is_robot else STATION_RULES
        self._decoder = FrameDecoder(MAX_STATION_PAYLOAD if self._is_robot else MAX_ROBOT_PAYLOAD)
        self._decode = decode_station_message if self._is_robot else decode_robot_message
        self._max_sent = MAX_ROBOT_PAYLOAD if self._is_robot else MAX_STATION_PAYLOAD
        self._heard_ns = now_ns
        self._ticked_ns = now_ns
        self._heartbeat_ns = now_ns
        self.state = State.OPENING
        self.close_reason = ""

    def receive(self, data: bytes) -> None:
        """Add bytes as they came; then take messages until there are none."""
        self._decoder.receive(data)

    def next_message(self, now_ns: int) -> Message | None:
        """The next whole message, already found allowed in the present state; None until more bytes arrive.

        Raises:
            RemoteProtocolError: not a message, of another version, or not allowed now. The session is closed then.
        """
        try:
            payload = self._decoder.next_payload()
            if payload is None:
                return None
            message = self._decode(payload)
            self._check_version(message)
            self._happen(event_of(message), str(message))
        except RemoteProtocolError as exc:
            self.close(Event.BROKE_RULES, str(exc))
            raise
        # Only whole messages count as life: a peer that trickles bytes is silent.
        self._heard_ns = now_ns
        return message

    def send(self, message: Message) -> bytes:
        """The bytes of a message to the peer. An error notice may be said always, also as the last word.

        Raises:
            LocalProtocolError: this side may not say it now, or it is too large.
        """
        event = _EVENT_OF.get(type(message))
        if event is None and not isinstance(message, ErrorNotice) and self.state not in _JOINED:
            raise LocalProtocolError(f"cannot send {message} while the connection is {self.state.value}")
        data = encode_payload(encode_message(message), self._max_sent)
        # The robot's own answer decides for both sides.
        if self._is_robot and isinstance(message, Welcome):
            self._happen(Event.WELCOME, str(message))
        elif self._is_robot and isinstance(message, Refusal):
            self.close(Event.REFUSAL, message.reason)
        elif self._is_robot and isinstance(message, Paired):
            self.close(Event.PAIRED, "paired")
        return data

    def tick(self, now_ns: int) -> list[Tick]:
        """What silence and the clock ask for. Call every 20 to 100 ms, after reading what has arrived."""
        if self.state is State.CLOSED:
            return []
        if now_ns - self._ticked_ns > OWN_PAUSE_NS:
            # What was heard before this tick, behind the pause, is no word of later.
            self._heard_ns = min(self._heard_ns + now_ns - self._ticked_ns, now_ns)
        self._ticked_ns = now_ns
        silence_ns = now_ns - self._heard_ns
        is_joined = self.state in _JOINED
        if silence_ns >= (CLOSE_AFTER_NS if is_joined else self._join_within_ns or JOIN_WITHIN_NS):
            waited_for = "anything" if is_joined else "the rest of the greeting"
            self.close(Event.TIMED_OUT, f"waited {silence_ns / 1e9:.0f} s for {waited_for} from the {self._peer}")
            return [Tick.CLOSE]
        duties = []
        if self.state is State.ACTIVE and silence_ns >= QUIET_AFTER_NS:
            self._happen(Event.WENT_QUIET, "silence")
            duties.append(Tick.WENT_QUIET)
        if is_joined and not self._is_robot and now_ns - self._heartbeat_ns >= HEARTBEAT_INTERVAL_NS:
            self._heartbeat_ns = now_ns
            duties.append(Tick.SEND_HEARTBEAT)
        return duties

    def close(self, event: Event, reason: str) -> None:
        """End the session; the first reason stays."""
        if self.state is not State.CLOSED:
            self.close_reason = reason
            self._happen(event, reason)

    def _check_version(self, message: Message) -> None:
        if isinstance(message, Hello | Join | PairRequest) and message.protocol != PROTOCOL_VERSION:
            raise RemoteProtocolError(version_mismatch(message.protocol, self._peer))

    def _happen(self, event: Event, what: str) -> None:
        following = self._rules[self.state].get(event)
        if following is None:
            raise RemoteProtocolError(f"the {self._peer} sent {what} while the connection was {self.state.value}")
        self.state = following


def event_of(message: Message) -> Event:
    """The event that a received message is."""
    if isinstance(message, ErrorNotice) and message.fatal:
        return Event.FATAL_ERROR
    return _EVENT_OF.get(type(message), Event.MESSAGE)


def reply_to(heartbeat: Heartbeat, received_ns: int, sent_ns: int, *, took_stop: bool = True) -> HeartbeatReply:
    """The robot's answer to a heartbeat, both times on the robot's clock."""
    return HeartbeatReply(
        seq=heartbeat.seq,
        t_station_ns=heartbeat.t_station_ns,
        t_robot_received_ns=received_ns,
        t_robot_sent_ns=sent_ns,
        took_stop=took_stop,
    )
