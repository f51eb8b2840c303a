"""Frames between the Pi and the Mega: COBS(type, body, CRC-16 low byte first), 0x00. Numbers are little-endian.

No I/O here. The C++ twin is `firmware/core/protocol.h`; `tests/golden/serial_frames.txt` holds bytes both must produce.
COBS: Cheshire and Baker, IEEE/ACM ToN 7(2), 1999. CRC-16/CCITT-FALSE: polynomial 0x1021, start 0xFFFF.
"""

from __future__ import annotations

import math
import struct
from binascii import crc_hqx
from enum import IntEnum, IntFlag
from typing import ClassVar, get_args

import msgspec
from msgspec.structs import astuple

from shared.errors import LocalProtocolError

PROTOCOL_VERSION = 2
MAX_PAYLOAD = 80  # type + body
MAX_FRAME = MAX_PAYLOAD + 4  # CRC, COBS code, delimiter
BAUD_RATE = 500_000  # exact on a 16 MHz AVR; 115200 is 2.1 % off


class Type(IntEnum):
    """First byte of a payload."""

    HELLO = 0x01
    IMU = 0x02
    STATUS = 0x03
    ACK = 0x04
    TIME = 0x05
    QUATERNION = 0x06
    RANGE = 0x07
    DRIVE = 0x10
    STOP = 0x11
    ASK_TIME = 0x12
    ASK_HELLO = 0x13
    CONFIG_IMU = 0x14
    CONFIG_MOTORS = 0x15
    SERVO = 0x16
    CONFIG_RANGE = 0x17


class Flag(IntFlag):
    """Bits of `Status.flags`."""

    IMU_MISSING = 1 << 0
    MAG_MISSING = 1 << 1
    BUS_ERROR = 1 << 2
    LOW_BATTERY = 1 << 3
    DRIVER_FAULT = 1 << 4
    DRIVING = 1 << 5
    TTL_STOP = 1 << 6


class Hello(msgspec.Struct, frozen=True):
    """Who the firmware is; sent at its start and when asked."""

    version: int
    firmware_major: int
    firmware_minor: int
    # Bits of MCUSR: 1 power on, 2 reset line (DTR), 4 brown-out, 8 watchdog. The stock bootloader clears it: 0 is then
    # any of the first three; a watchdog reset is told as 8 all the same unless the firmware hung with interrupts off.
    reset_cause: int
    imu_address: int  # 0 while none was found
    imu_who: int
    gyro_scale: int
    accel_scale: int
    gyro_filter: int
    accel_filter: int
    divider: int
    boot_id: int  # counts resets since power on


GYRO_RANGES_DEG_S = (250.0, 500.0, 1000.0, 2000.0)
ACCEL_RANGES_G = (2.0, 4.0, 8.0, 16.0)
STANDARD_GRAVITY = 9.80665  # m/s^2, what the accelerometer's g means


class ImuPacket(msgspec.Struct, frozen=True):
    """One burst of the ICM-20948 as it lay in its registers."""

    BURST: ClassVar = struct.Struct(">7h")  # accel, gyro, temperature; big-endian

    sequence: int  # counts data-ready interrupts
    t_us: int  # Mega's clock, wraps at 2^32
    scales: int  # gyro_scale | accel_scale << 4
    burst: bytes  # and behind BURST the magnetometer's ST1, x, y, z, reserved, ST2: "<BhhhBB"

    def raw(self) -> tuple[int, ...]:
        """Accel x y z, gyro x y z, temperature: counts."""
        return tuple(self.BURST.unpack_from(self.burst))

    def accel_imu(self) -> tuple[float, float, float]:
        """Specific force, m/s^2."""
        unit = ACCEL_RANGES_G[self.scales >> 4 & 3] * STANDARD_GRAVITY / 32768.0
        x, y, z = self.raw()[0:3]
        return x * unit, y * unit, z * unit

    def gyro_imu(self) -> tuple[float, float, float]:
        """Angular rate, rad/s."""
        unit = math.radians(GYRO_RANGES_DEG_S[self.scales & 3]) / 32768.0
        x, y, z = self.raw()[3:6]
        return x * unit, y * unit, z * unit


class Status(msgspec.Struct, frozen=True):
    """Health of the Mega, ten times a second."""

    uptime_ms: int
    flags: int
    samples: int
    samples_lost: int
    bus_errors: int
    bus_recoveries: int
    imu_starts: int
    rx_frames: int
    rx_bad: int
    rx_overruns: int
    tx_dropped: int
    ttl_stops: int
    battery_mv: int
    left: int  # permille at the pins
    right: int
    loop_max_us: int
    stack_free: int


class Ack(msgspec.Struct, frozen=True):
    """Answer to a configuration or servo command, and to a drive command that was refused."""

    asked: int
    result: int  # 0 done, 1 bad length, 2 bad value, 3 unknown type, 4 too late


class MegaTime(msgspec.Struct, frozen=True):
    """Answer to `AskTime`: the Mega's clock."""

    token: int
    t_us: int


class Echo(IntEnum):
    HEARD = 0
    NONE = 1  # nothing in reach, or nothing that sends sound back
    SILENT = 2  # the sensor does not answer


class RangePacket(msgspec.Struct, frozen=True):
    """One measurement of an HC-SR04: how long sound took there and back. Only where `ConfigRange` asked for it."""

    sequence: int
    t_us: int  # Mega's clock: when the sound turned round; of no echo, when that was known
    echo_us: int  # 0 where none was heard
    echo: int  # as `Echo` says


class Drive(msgspec.Struct, frozen=True):
    """Speeds in permille of full duty, and when they end without another command.

    A time of the Mega's own clock, so that a command which waited on its way is seen to be late.
    """

    left: int
    right: int
    until_ms: int  # the Mega's uptime, 32 bits
    boot_id: int  # of the boot whose uptime it is

    def __post_init__(self) -> None:
        if not (abs(self.left) <= 1000 and abs(self.right) <= 1000):
            raise LocalProtocolError(f"{self} is outside -1000..1000 permille")


class Stop(msgspec.Struct, frozen=True):
    """Both motors off now."""


class AskTime(msgspec.Struct, frozen=True):
    token: int


class AskHello(msgspec.Struct, frozen=True):
    """Asks for a hello."""


class ConfigImu(msgspec.Struct, frozen=True):
    """Full scales 0..3 (250..2000 deg/s, 2..16 g), low-pass filters 0..7 (DLPFCFG), rate 1125 / (1 + divider) Hz."""

    gyro_scale: int = 1
    accel_scale: int = 1
    gyro_filter: int = 3
    accel_filter: int = 3
    divider: int = 4


class ConfigMotors(msgspec.Struct, frozen=True):
    """Decay, ramps (permille per ms) and battery cut-off (0: no battery sensed)."""

    slow_decay: bool = True
    ramp_up: int = 4
    ramp_down: int = 10
    cutoff_mv: int = 0


class Servo(msgspec.Struct, frozen=True):
    """Pulse widths, 500..2500 us; 0 lets a servo go."""

    pan_us: int
    tilt_us: int


class ConfigRange(msgspec.Struct, frozen=True):
    """How often the HC-SR04 measures: every 50..250 ms; 0: there is none. Firmware before 2.1 does not know it."""

    period_ms: int


FirmwareMessage = Hello | ImuPacket | Status | Ack | MegaTime | RangePacket
Command = Drive | Stop | AskTime | AskHello | ConfigImu | ConfigMotors | Servo | ConfigRange

_BODIES: dict[type[FirmwareMessage | Command], tuple[Type, struct.Struct]] = {
    Hello: (Type.HELLO, struct.Struct("<11BH")),
    ImuPacket: (Type.IMU, struct.Struct("<IIB23s")),
    Status: (Type.STATUS, struct.Struct("<IHII9HhhHH")),
    Ack: (Type.ACK, struct.Struct("<BB")),
    MegaTime: (Type.TIME, struct.Struct("<II")),
    RangePacket: (Type.RANGE, struct.Struct("<HIHB")),
    Drive: (Type.DRIVE, struct.Struct("<hhIH")),
    Stop: (Type.STOP, struct.Struct("")),
    AskTime: (Type.ASK_TIME, struct.Struct("<I")),
    AskHello: (Type.ASK_HELLO, struct.Struct("")),
    ConfigImu: (Type.CONFIG_IMU, struct.Struct("<5B")),
    ConfigMotors: (Type.CONFIG_MOTORS, struct.Struct("<BBBH")),
    Servo: (Type.SERVO, struct.Struct("<HH")),
    ConfigRange: (Type.CONFIG_RANGE, struct.Struct("<B")),
}
_FIRMWARE_MESSAGES: dict[int, type[FirmwareMessage]] = {
    _BODIES[message][0]: message for message in get_args(FirmwareMessage)
}


def crc16(data: bytes) -> int:
    """CRC-16/CCITT-FALSE: `crc16(b"123456789") == 0x29B1`."""
    return crc_hqx(data, 0xFFFF)


def cobs_encode(data: bytes) -> bytes:
    """Data below 254 bytes without zeros, one byte longer."""
    if len(data) >= 254:
        raise LocalProtocolError(f"frame of {len(data)} bytes, the limit is 253")
    return b"".join(bytes([len(block) + 1]) + block for block in data.split(b"\0"))


def cobs_decode(data: bytes) -> bytes | None:
    """Inverse of `cobs_encode`; None where a code points beyond the end."""
    blocks: list[bytes] = []
    at = 0
    while at < len(data):
        code = data[at]
        if code == 0 or at + code > len(data):
            return None
        blocks.append(data[at + 1 : at + code])
        at += code
    return b"\0".join(blocks)


def encode_frame(payload: bytes) -> bytes:
    """Payload to frame with its delimiter."""
    if not 0 < len(payload) <= MAX_PAYLOAD:
        raise LocalProtocolError(f"payload of {len(payload)} bytes, allowed are 1..{MAX_PAYLOAD}")
    return cobs_encode(payload + crc16(payload).to_bytes(2, "little")) + b"\0"


def encode(command: Command) -> bytes:
    """A command's frame."""
    return encode_frame(pack(command))


def pack(message: FirmwareMessage | Command) -> bytes:
    """Payload of a message. A drive command repeats its body inverted: a CRC-16 lets one damage in 65536 pass."""
    kind, layout = _BODIES[type(message)]
    body = layout.pack(*astuple(message))
    return bytes([kind]) + body + (bytes(b ^ 0xFF for b in body) if isinstance(message, Drive) else b"")


def parse(payload: bytes) -> FirmwareMessage | None:
    """Firmware message of a checked payload; None where type or length are not known to this version."""
    message = _FIRMWARE_MESSAGES.get(payload[0])
    if message is None or len(payload) != 1 + _BODIES[message][1].size:
        return None
    return message(*_BODIES[message][1].unpack_from(payload, 1))


class SerialDecoder:
    """Cuts the Mega's byte stream into payloads. Damage costs the frame it hits and at most the one behind it."""

    def __init__(self) -> None:
        self._buffer = bytearray()
        self._skipping = False
        self.frames = 0
        self.bad = 0

    def receive(self, data: bytes) -> list[bytes]:
        """Payloads completed by these bytes. Never raises; damage is counted in `bad`."""
        *ended, rest = data.split(b"\0")
        payloads = [payload for piece in ended if (payload := self._end_frame(piece)) is not None]
        self._collect(rest)
        return payloads

    def _collect(self, piece: bytes) -> None:
        if len(self._buffer) + len(piece) >= MAX_FRAME:
            self._skipping = True
            self._buffer.clear()
        elif not self._skipping:
            self._buffer += piece

    def _end_frame(self, piece: bytes) -> bytes | None:
        self._collect(piece)
        frame, skipped = bytes(self._buffer), self._skipping
        self._buffer.clear()
        self._skipping = False
        if not frame and not skipped:
            return None
        decoded = None if skipped else cobs_decode(frame)
        if decoded is None or len(decoded) < 3 or crc16(decoded[:-2]) != int.from_bytes(decoded[-2:], "little"):
            self.bad += 1
            return None
        self.frames += 1
        return decoded[:-2]
