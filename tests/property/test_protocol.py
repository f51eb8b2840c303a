"""Laws of the wire: any message survives, any split of the stream gives the same, no bytes break a session."""

from __future__ import annotations

import math

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shared.calibration import REFERENCE_ROBOT
from shared.errors import LocalProtocolError, RemoteProtocolError
from shared.framing import MAX_ROBOT_PAYLOAD, MAX_STATION_PAYLOAD, FrameDecoder, encode_payload
from shared.message_codec import decode_robot_message, decode_station_message, encode_message
from shared.messages import (
    MAX_ANGULAR_RAD_S,
    MAX_COUNT,
    MAX_DRIVE_TTL_MS,
    MAX_LINEAR_M_S,
    MAX_TIME_NS,
    CameraFrame,
    Capabilities,
    Depth,
    Drive,
    DriveApplied,
    ErrorNotice,
    Heartbeat,
    HeartbeatReply,
    Hello,
    Hijack,
    ImuBatch,
    ImuSample,
    Join,
    Message,
    Paired,
    PairProof,
    PairReply,
    PairRequest,
    PanTilt,
    Prove,
    Received,
    Refusal,
    RobotMessage,
    StationMessage,
    Status,
    Stop,
    Welcome,
)
from shared.session import Session, State
from shared.text import is_printable, is_seen_whole, is_unseen

TIME = st.integers(-MAX_TIME_NS, MAX_TIME_NS)
COUNT = st.integers(0, MAX_COUNT)
NEXT = st.integers(-1, MAX_COUNT)
ANY_FLOAT = st.floats(allow_nan=False)
FINITE = st.floats(allow_nan=False, allow_infinity=False)
NAME = st.text(min_size=1, max_size=64).filter(is_printable)
SENTENCE = st.text(max_size=1000)
VECTOR = st.tuples(ANY_FLOAT, ANY_FLOAT, ANY_FLOAT)


def floats_within(limit: float) -> st.SearchStrategy[float]:
    return st.floats(-limit, limit)


STATION_MESSAGES: st.SearchStrategy[StationMessage] = st.one_of(
    st.builds(
        Join,
        protocol=COUNT,
        station_name=NAME,
        resume_session_id=st.just("") | NAME,
        knows_depth=st.booleans(),
        station_id=st.just("") | NAME,
    ),
    st.builds(Heartbeat, seq=COUNT, t_station_ns=TIME),
    st.builds(
        Drive,
        seq=COUNT,
        t_station_ns=TIME,
        linear=floats_within(MAX_LINEAR_M_S),
        angular=floats_within(MAX_ANGULAR_RAD_S),
        ttl_ms=st.integers(1, MAX_DRIVE_TTL_MS),
    ),
    st.builds(Received, frame_seq=NEXT, next_imu_sequence=NEXT),
    st.builds(Stop, seq=COUNT),
    st.builds(Prove, token_id=NAME, proof=st.binary(min_size=32, max_size=32)),
    st.builds(PairRequest, protocol=COUNT, station_name=NAME, message=st.binary(min_size=33, max_size=33)),
    st.builds(PairProof, mac=st.binary(min_size=32, max_size=32)),
    st.builds(PanTilt, pan=floats_within(math.pi), tilt=floats_within(math.pi)),
    st.builds(Hijack, x=floats_within(1000), y=floats_within(1000), yaw=floats_within(6.28)),
)
ROBOT_MESSAGES: st.SearchStrategy[RobotMessage] = st.one_of(
    st.builds(
        Hello,
        protocol=COUNT,
        robot_id=NAME.filter(is_seen_whole).filter(lambda name: not is_unseen(name)),
        name=NAME.filter(lambda name: not is_unseen(name)),
        session_id=NAME,
        capabilities=st.builds(
            Capabilities,
            camera=st.booleans(),
            imu=st.booleans(),
            drive=st.booleans(),
            pan_tilt=st.booleans(),
            battery=st.booleans(),
            hijack=st.booleans(),
        ),
        calibration=st.just(REFERENCE_ROBOT),
        challenge=st.binary(max_size=64),
    ),
    st.builds(PairReply, message=st.binary(min_size=33, max_size=33)),
    st.builds(Paired, mac=st.binary(min_size=32, max_size=32), token=NAME),
    st.builds(Welcome, client_id=COUNT),
    st.builds(Refusal, reason=SENTENCE),
    st.builds(HeartbeatReply, seq=COUNT, t_station_ns=TIME, t_robot_received_ns=TIME, t_robot_sent_ns=TIME),
    st.builds(
        CameraFrame,
        seq=COUNT,
        t_robot_ns=TIME,
        exposure_ns=COUNT,
        width=st.integers(1, 8192),
        height=st.integers(1, 8192),
        skipped=COUNT,
        jpeg=st.binary(max_size=2000),
    ),
    st.builds(
        ImuBatch,
        first_sequence=COUNT,
        samples=st.lists(st.builds(ImuSample, TIME, VECTOR, VECTOR), min_size=1, max_size=8).map(tuple),
    ),
    st.builds(Depth, seq=COUNT, t_robot_ns=TIME, png=st.binary(max_size=2000)),
    st.builds(DriveApplied, t_robot_ns=TIME, linear=FINITE, angular=FINITE),
    st.builds(
        Status,
        t_robot_ns=TIME,
        uptime_s=ANY_FLOAT,
        battery_v=st.none() | ANY_FLOAT,
        temperatures_c=st.dictionaries(NAME, ANY_FLOAT, max_size=3),
        frames_skipped=COUNT,
        driver=st.none() | NAME,
        faults=st.lists(SENTENCE, max_size=3).map(tuple),
    ),
    st.builds(ErrorNotice, code=st.sampled_from(["protocol", "device"]), message=SENTENCE, fatal=st.booleans()),
)


@given(message=ROBOT_MESSAGES)
def test_any_robot_message_survives_the_wire(message: RobotMessage) -> None:
    assert decode_robot_message(encode_message(message)) == message


@given(message=STATION_MESSAGES)
def test_any_station_message_survives_the_wire_and_fits_its_limit(message: StationMessage) -> None:
    payload = encode_message(message)
    assert len(payload) <= MAX_STATION_PAYLOAD
    assert decode_station_message(payload) == message


@given(message=ROBOT_MESSAGES)
def test_a_messages_text_is_short(message: RobotMessage) -> None:
    assert len(str(message)) < 200


@given(payloads=st.lists(st.binary(min_size=1, max_size=50)), cuts=st.lists(st.integers(0, 300)))
def test_any_split_of_the_stream_gives_the_same_payloads(payloads: list[bytes], cuts: list[int]) -> None:
    stream = b"".join(encode_payload(p, 50) for p in payloads)
    decoder, received, start = FrameDecoder(max_payload=50), [], 0
    for end in [*sorted(c for c in cuts if c < len(stream)), len(stream)]:
        decoder.receive(stream[start:end])
        start = end
        while (payload := decoder.next_payload()) is not None:
            received.append(payload)
    assert received == payloads
    decoder.receive(encode_payload(b"next", 50))
    assert decoder.next_payload() == b"next"  # nothing was left over before it


@given(payload=st.binary(min_size=1, max_size=50), cut=st.integers(1, 49))
def test_a_cut_payload_is_never_taken_for_a_whole_one(payload: bytes, cut: int) -> None:
    stream = encode_payload(payload, 50)
    decoder = FrameDecoder(max_payload=50)
    cut = min(cut, len(stream) - 1)
    decoder.receive(stream[:cut])
    assert decoder.next_payload() is None
    decoder.receive(stream[cut:])
    assert decoder.next_payload() == payload


@given(payload=st.binary(min_size=1, max_size=50), bit=st.integers(0, 8 * 62 - 1))
def test_no_damaged_bit_becomes_a_payload_or_is_waited_for(payload: bytes, bit: int) -> None:
    stream = bytearray(encode_payload(payload, 50))
    at = bit % (8 * len(stream))
    stream[at // 8] ^= 1 << at % 8
    decoder = FrameDecoder(max_payload=50)
    decoder.receive(bytes(stream))
    with pytest.raises(RemoteProtocolError, match=r"damaged on their way|was announced"):
        decoder.next_payload()


@pytest.mark.parametrize("length", [0, 51, 2**32 - 1])
def test_a_length_outside_the_limit_is_refused_before_the_payload_comes(length: int) -> None:
    decoder = FrameDecoder(max_payload=50)
    decoder.receive(length.to_bytes(4, "big"))
    with pytest.raises(RemoteProtocolError, match=f"{length} bytes was announced, allowed are 1..50"):
        decoder.next_payload()


@pytest.mark.parametrize("payload", [b"", b"x" * 51])
def test_our_own_oversize_payload_is_our_bug(payload: bytes) -> None:
    with pytest.raises(LocalProtocolError):
        encode_payload(payload, 50)


@given(data=st.lists(st.binary(max_size=200), max_size=8), role=st.sampled_from(["robot", "station"]))
def test_random_bytes_end_a_session_or_wait_for_more(data: list[bytes], role: str) -> None:
    session = Session("robot" if role == "robot" else "station", 0)
    refused = ""
    try:
        for piece in data:
            session.receive(piece)
            while session.next_message(0) is not None:
                pass
    except RemoteProtocolError as exc:
        refused = str(exc)
    assert session.close_reason == refused
    assert session.state is (State.CLOSED if refused else State.OPENING)


@given(payload=st.binary(min_size=1, max_size=300))
def test_random_payloads_are_refused_with_a_sentence(payload: bytes) -> None:
    for decode in (decode_robot_message, decode_station_message):
        with pytest.raises(RemoteProtocolError):
            decode(payload)


@settings(max_examples=200)
@given(message=st.one_of(ROBOT_MESSAGES, STATION_MESSAGES), data=st.data())
def test_a_damaged_message_is_refused_or_is_another_valid_one(message: Message, data: st.DataObject) -> None:
    payload = bytearray(encode_message(message))
    position = data.draw(st.integers(0, len(payload) - 1))
    payload[position] ^= data.draw(st.integers(1, 255))
    for decode in (decode_robot_message, decode_station_message):
        try:
            decoded: Message = decode(bytes(payload))
        except RemoteProtocolError:
            continue
        assert encode_message(decoded)


@given(
    value=st.sampled_from([math.nan, math.inf, -math.inf, 3.01, -1e300]), field=st.sampled_from(["linear", "angular"])
)
def test_a_drive_command_that_is_no_speed_is_refused(value: float, field: str) -> None:
    if field == "angular" and abs(value) < 12:
        value *= 4
    content = {"type": "drive", "seq": 1, "t_station_ns": 0, "linear": 0.0, "angular": 0.0, "ttl_ms": 100}
    with pytest.raises(RemoteProtocolError, match=f"{field} .* is outside"):
        decode_station_message(msgspec.msgpack.encode({**content, field: value}))


@pytest.mark.parametrize("ttl_ms", [0, -1, MAX_DRIVE_TTL_MS + 1, 10**12])
def test_a_time_to_live_beyond_the_limit_is_refused(ttl_ms: int) -> None:
    content = {"type": "drive", "seq": 1, "t_station_ns": 0, "linear": 0.0, "angular": 0.0, "ttl_ms": ttl_ms}
    with pytest.raises(RemoteProtocolError, match="ttl_ms"):
        decode_station_message(msgspec.msgpack.encode(content))


@given(more=st.dictionaries(st.text(min_size=1, max_size=8).map("x_".__add__), st.integers(0, 9), max_size=3))
def test_fields_of_a_later_release_are_ignored(more: dict[str, int]) -> None:
    assert decode_station_message(msgspec.msgpack.encode({"type": "stop", "seq": 1, **more})) == Stop(seq=1)


def test_a_first_message_of_a_later_version_is_recognised_whatever_else_it_holds() -> None:
    payload = msgspec.msgpack.encode({"type": "hello", "protocol": 99, "everything": "else"})
    with pytest.raises(RemoteProtocolError, match="speaks protocol version 99"):
        decode_robot_message(payload)


def test_deep_nesting_is_refused() -> None:
    with pytest.raises(RemoteProtocolError):
        decode_station_message(b"\x81\xa1x" * 1300)


def test_the_robots_limit_has_room_for_a_large_jpeg() -> None:
    frame = CameraFrame(seq=0, t_robot_ns=0, exposure_ns=0, width=1, height=1, skipped=0, jpeg=bytes(3 * 2**20))
    assert encode_payload(encode_message(frame), MAX_ROBOT_PAYLOAD)
