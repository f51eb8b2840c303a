"""The serial language of Pi and Mega: any cut of the stream, any damage."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from shared import serial_protocol as sp
from shared.errors import LocalProtocolError
from tests.support.imu_packets import MAG, mag_imu, temperature_c

GOLDEN = [
    line.split() for line in (Path(__file__).parents[1] / "golden" / "serial_frames.txt").read_text().splitlines()
]
payloads = st.binary(min_size=1, max_size=sp.MAX_PAYLOAD)


def test_crc_gives_the_published_check_value() -> None:
    assert sp.crc16(b"123456789") == 0x29B1


@pytest.mark.parametrize(("name", "payload", "frame"), GOLDEN)
def test_frames_equal_the_golden_bytes(name: str, payload: str, frame: str) -> None:
    assert sp.encode_frame(bytes.fromhex(payload)).hex() == frame


def test_messages_pack_to_the_golden_payloads() -> None:
    payload = {name: bytes.fromhex(payload) for name, payload, _ in GOLDEN}
    assert sp.pack(sp.Drive(-1000, 250, 70300, 513)) == payload["drive"]
    assert sp.pack(sp.Servo(1500, 0)) == payload["servo"]
    assert sp.pack(sp.ConfigMotors(True, 4, 10, 6400)) == payload["config_motors"]
    assert sp.pack(sp.ConfigRange(100)) == payload["config_range"]
    assert sp.parse(payload["range"]) == sp.RangePacket(65535, 0xFFFFFFF0, 5831, sp.Echo.HEARD)
    assert sp.parse(payload["hello"]) == sp.Hello(2, 2, 0, 8, 0x69, 0xEA, 1, 1, 3, 3, 4, 513)
    status = sp.parse(payload["status"])
    assert isinstance(status, sp.Status) and (status.left, status.battery_mv, status.stack_free) == (-1000, 7400, 6000)


@given(st.binary(max_size=253))
def test_cobs_has_no_zero_and_decodes_back(data: bytes) -> None:
    encoded = sp.cobs_encode(data)
    assert 0 not in encoded
    assert sp.cobs_decode(encoded) == data


@given(payloads=st.lists(payloads, max_size=20), cuts=st.lists(st.integers(0, 1700)))
def test_any_split_of_the_stream_gives_the_same_payloads(payloads: list[bytes], cuts: list[int]) -> None:
    stream = b"".join(map(sp.encode_frame, payloads))
    decoder, received, start = sp.SerialDecoder(), [], 0
    for end in [*sorted(c for c in cuts if c < len(stream)), len(stream)]:
        received += decoder.receive(stream[start:end])
        start = end
    assert received == payloads
    assert decoder.bad == 0


@given(noise=st.binary(max_size=300), payload=payloads)
def test_a_frame_after_noise_and_a_delimiter_is_read(noise: bytes, payload: bytes) -> None:
    decoder = sp.SerialDecoder()
    decoder.receive(noise + b"\0")
    assert decoder.receive(sp.encode_frame(payload)) == [payload]


@given(payload=payloads, data=st.data())
def test_a_flipped_byte_is_noticed(payload: bytes, data: st.DataObject) -> None:
    frame = bytearray(sp.encode_frame(payload))
    at = data.draw(st.integers(0, len(frame) - 2))
    frame[at] ^= data.draw(st.integers(1, 255))
    decoder = sp.SerialDecoder()
    assert payload not in decoder.receive(bytes(frame))


@given(st.binary(min_size=1, max_size=sp.MAX_PAYLOAD))
def test_parsing_any_payload_gives_a_message_or_none(payload: bytes) -> None:
    message = sp.parse(payload)
    assert message is None or sp.pack(message) == payload


def test_imu_counts_become_si_units_in_the_imu_frame() -> None:
    burst = sp.ImuPacket.BURST.pack(8192, -8192, 0, 16384, 0, -16384, 334) + MAG.pack(1, 100, 100, -100, 0, 0x10)
    packet = sp.ImuPacket(1, 2, 0x11, burst)
    assert packet.accel_imu() == pytest.approx((9.80665, -9.80665, 0.0))
    assert packet.gyro_imu() == pytest.approx((4.363323, 0.0, -4.363323))
    assert temperature_c(packet) == pytest.approx(22.0, abs=0.01)
    assert mag_imu(packet) == pytest.approx((15.0, -15.0, 15.0))
    stale = sp.ImuPacket(1, 2, 0x11, burst[:14] + b"\0" + burst[15:])
    assert mag_imu(stale) is None


def test_values_the_firmware_would_refuse_are_refused_here() -> None:
    with pytest.raises(LocalProtocolError):
        sp.pack(sp.Drive(1001, 0, 100, 1))
    with pytest.raises(LocalProtocolError):
        sp.encode_frame(bytes(sp.MAX_PAYLOAD + 1))
