"""Damaged bytes for the serial reader and the session; used by tests and by benchmarks/bench_fuzz.py."""

from __future__ import annotations

import random
from dataclasses import dataclass, field
from typing import Any

from robot.commands import CommandDesk
from robot.config import DriveConfig
from robot.devices.ports import DeviceSet
from robot.watchdog import Velocity
from shared import serial_protocol as sp
from shared.calibration import REFERENCE_ROBOT
from shared.errors import LocalProtocolError, RemoteProtocolError
from shared.framing import MAX_STATION_PAYLOAD, encode_payload
from shared.message_codec import encode_message
from shared.messages import PROTOCOL_VERSION, Drive, Heartbeat, Join, PanTilt, Stop, Welcome
from shared.session import Session, State
from tests.support.imu_packets import mag_imu, temperature_c
from tests.support.paths import ROOT

GOLDEN = ROOT / "tests" / "golden" / "serial_frames.txt"


def damage(data: bytes, rng: random.Random) -> bytes:
    """Flips, replacements, holes and insertions; sometimes none, sometimes noise only."""
    if rng.random() < 0.05:
        return rng.randbytes(rng.randrange(200))
    out = bytearray(data)
    for _ in range(rng.randrange(4)):
        if not out:
            break
        at, kind = rng.randrange(len(out)), rng.randrange(4)
        if kind == 0:
            out[at] ^= 1 << rng.randrange(8)
        elif kind == 1:
            out[at] = rng.randrange(256)
        elif kind == 2:
            del out[at : at + rng.randrange(1, 5)]
        else:
            out[at:at] = rng.randbytes(rng.randrange(1, 5))
    return bytes(out)


def fuzz_serial_reader(inputs: int, seed: int) -> dict[str, Any]:
    """The Mega's stream as the Pi reads it, one decoder for all inputs: it must stay usable."""
    rng = random.Random(seed)
    frames = [bytes.fromhex(line.split()[2]) for line in GOLDEN.read_text().splitlines()]
    decoder, parsed = sp.SerialDecoder(), 0
    for _ in range(inputs):
        for payload in decoder.receive(damage(rng.choice(frames), rng)):
            message = sp.parse(payload)
            if isinstance(message, sp.ImuPacket):
                message.accel_imu(), message.gyro_imu(), mag_imu(message), temperature_c(message)
            parsed += message is not None
    assert len(decoder.receive(b"\0" + frames[0])) >= 1, "the reader does not find a good frame after the bad ones"
    return {"inputs": inputs, "frames": decoder.frames, "refused": decoder.bad, "understood": parsed}


@dataclass
class CountingGuard:
    """Stands where the motors' watchdog stands, and looks at what would reach the motors."""

    commands: int = 0
    worst: Velocity = field(default_factory=Velocity)

    now_ns: int = 0

    def command(self, wish: Velocity, until_ns: int, starts_until_ns: int | None = None) -> bool:
        assert abs(wish.linear_m_s) <= 0.5 and abs(wish.angular_rad_s) <= 2.5, f"{wish} is beyond the robot's limits"
        assert 0 < until_ns - self.now_ns <= 250_000_000, f"{until_ns} ns is longer than a command may last"
        self.commands += 1
        return True

    stop_fault = ""

    def stop(self) -> None: ...


def fuzz_tcp_decoder(inputs: int, seed: int) -> dict[str, Any]:
    """A station's stream as robot-server takes it: session rules, messages, and who may drive.

    TCP carries a checksum, our messages none: a damaged drive command may still be one. So the law is that nothing
    drives before it has joined, and nothing beyond the limits.
    """
    rng = random.Random(seed)
    devices = DeviceSet(calibration=REFERENCE_ROBOT, camera=None, imu=None, motors=None)
    result = {
        "inputs": inputs,
        "messages": 0,
        "broke_rules": 0,
        "refused_by_desk": 0,
        "drives": 0,
        "drives_unjoined": 0,
    }
    t_ns = 0
    for number in range(inputs):
        guard = CountingGuard(now_ns=t_ns + 1_000_000)
        desk = CommandDesk(devices, guard, DriveConfig())  # type: ignore[arg-type]
        session = Session("robot", t_ns)
        joins = number % 4 != 0
        if joins:
            join = Join(protocol=PROTOCOL_VERSION, station_name="fuzz")
            session.receive(encode_payload(encode_message(join), MAX_STATION_PAYLOAD))
            session.next_message(t_ns)
            session.send(Welcome(client_id=1))
            past_ns = t_ns - 60_000_000  # a command counts only where an earlier message tells how late it is
            desk.handle(1, Heartbeat(seq=-1, t_station_ns=past_ns), past_ns)
        messages = (
            Drive(seq=number, t_station_ns=t_ns, linear=0.4, angular=-2.0, ttl_ms=250),
            Stop(seq=number),
            Heartbeat(seq=number, t_station_ns=t_ns),
            PanTilt(pan=0.1, tilt=0.2),
        )
        data = damage(encode_payload(encode_message(rng.choice(messages)), MAX_STATION_PAYLOAD), rng)
        cut = rng.randrange(len(data) + 1)
        t_ns += 1_000_000
        try:
            for piece in (data[:cut], data[cut:]):
                session.receive(piece)
                while (message := session.next_message(t_ns)) is not None:
                    result["messages"] += 1
                    if session.state is State.ACTIVE and not isinstance(message, Join):
                        result["refused_by_desk"] += desk.handle(1, message, t_ns) is not None  # type: ignore[arg-type]
        except (RemoteProtocolError, LocalProtocolError):
            result["broke_rules"] += 1
        result["drives"] += guard.commands
        result["drives_unjoined"] += guard.commands if not joins else 0
    assert result["drives_unjoined"] == 0, "somebody drove without having joined"
    return result
