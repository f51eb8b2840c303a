"""The bytes of protocol version 2. A change here breaks robots and stations of an earlier release: raise the version.

Made once by `encode_message` of the messages below; msgpack maps keep the order of fields.
"""

from __future__ import annotations

import hashlib
from pathlib import Path

import msgspec
import pytest

from shared.calibration import Calibration, CameraCalibration, ImuNoise
from shared.datagrams import Sealer
from shared.framing import encode_payload
from shared.message_codec import decode_robot_message, decode_station_datagram, decode_station_message, encode_message
from shared.messages import (
    PROTOCOL_VERSION,
    AskDatagrams,
    CalibrationChanged,
    CalibrationOrigin,
    CameraFrame,
    DatagramReport,
    Datagrams,
    Depth,
    Drive,
    DriveApplied,
    ErrorNotice,
    Heartbeat,
    HeartbeatReply,
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
    PictureArrival,
    Prove,
    Received,
    Refusal,
    Status,
    Stop,
    UndoCalibration,
    UseCalibration,
    Welcome,
)
from shared.picture_pieces import cut

GOLDEN = Path(__file__).with_name("wire_v2.json")
T = 1_403_715_283_262_142_976
TOLD = Calibration(
    camera=CameraCalibration(width=640, height=480, fx=500.5, fy=501.5, cx=320.0, cy=240.0, time_shift_s=-0.5),
    imu=ImuNoise(gyro_density=0.5, accel_density=0.25, gyro_walk=0.125, accel_walk=1.5, rate_hz=225.0),
)
FROM_STATION: list[Message] = [
    Join(protocol=2, station_name="desk", resume_session_id="ab", next_imu_sequence=7),
    Heartbeat(seq=1, t_station_ns=T),
    Received(frame_seq=3, next_imu_sequence=9),
    Drive(seq=2, t_station_ns=T, linear=0.25, angular=-0.5, ttl_ms=200),
    Stop(seq=3),
    PanTilt(pan=0.5, tilt=-0.25),
    Hijack(x=1.5, y=-2.0, yaw=0.5),
    Prove(token_id="0123456789ab", proof=bytes(range(32))),
    PairRequest(protocol=2, station_name="desk", message=bytes(range(33))),
    PairProof(mac=bytes(range(32))),
    UseCalibration(calibration=TOLD),
    UndoCalibration(),
    AskDatagrams(port=7401),
]
FROM_ROBOT: list[Message] = [
    Welcome(client_id=4),
    Refusal(reason="full"),
    PairReply(message=bytes(range(33))),
    Paired(mac=bytes(range(32)), token="sentinel_0123456789ab_x"),
    HeartbeatReply(seq=1, t_station_ns=T, t_robot_received_ns=5, t_robot_sent_ns=6),
    CameraFrame(seq=8, t_robot_ns=T, exposure_ns=10, width=640, height=480, skipped=1, jpeg=b"\xff\xd8\xff\xd9"),
    Depth(seq=3, t_robot_ns=T, png=b"\x89PNG\r\n\x1a\n"),
    ImuBatch(first_sequence=5, samples=(ImuSample(T, (0.5, -0.25, 0.0), (0.0, 0.125, 9.75)),)),
    DriveApplied(t_robot_ns=T, linear=0.25, angular=-0.5),
    Status(t_robot_ns=T, uptime_s=1.5, battery_v=7.5, temperatures_c={"cpu": 50.5}, driver="desk", faults=("x",)),
    CalibrationChanged(calibration=TOLD, origin=CalibrationOrigin(source="its calibration.yaml", can_undo=True)),
    ErrorNotice(code="device", message="camera gone", fatal=False),
    Datagrams(session=7, key_to_station=bytes(range(32)), key_to_robot=bytes(range(32, 64))),
]
REPORT = DatagramReport(
    seq=9, t_station_ns=T, newest=41, pictures=(PictureArrival(3, 7, 0, 60_000_000, 8, 20_000_000),)
)


def golden() -> dict[str, str]:
    return msgspec.json.decode(GOLDEN.read_bytes(), type=dict[str, str])


@pytest.mark.parametrize("message", [*FROM_STATION, *FROM_ROBOT], ids=lambda m: type(m).__name__)
def test_messages_have_the_bytes_they_always_had(message: Message) -> None:
    assert PROTOCOL_VERSION == 2, "write wire_v3.json beside this one"
    assert encode_message(message).hex() == golden()[type(message).__name__]


@pytest.mark.parametrize("message", [*FROM_STATION, *FROM_ROBOT], ids=lambda m: type(m).__name__)
def test_the_old_bytes_are_still_understood(message: Message) -> None:
    decode = decode_station_message if message in FROM_STATION else decode_robot_message
    assert decode(bytes.fromhex(golden()[type(message).__name__])) == message


def test_the_report_of_datagrams_has_the_bytes_it_always_had() -> None:
    assert encode_message(REPORT).hex() == golden()["DatagramReport"]
    assert decode_station_datagram(bytes.fromhex(golden()["DatagramReport"])) == REPORT


def test_datagrams_are_sealed_as_they_always_were() -> None:
    """A picture of three pieces and two of parity, the last of these as it is sent."""
    sealer, content = Sealer(bytes(range(32)), 7), bytes(n * n % 251 for n in range(3000))
    last = [sealer.seal(piece) for piece in cut(content, 5, 2)][-1]
    assert hashlib.sha256(last).hexdigest() == golden()["SHA-256 of a datagram"]


def test_a_payload_has_the_header_it_always_had() -> None:
    assert encode_payload(encode_message(Stop(seq=3)), 100).hex() == golden()["header and Stop"]
