"""Writes serial_frames.txt: name, payload, frame (hex), one message a line. Both twins are held to it."""

from pathlib import Path

from shared import serial_protocol as sp

EXAMPLES: list[tuple[str, bytes]] = [
    ("hello", sp.pack(sp.Hello(2, 2, 0, 8, 0x69, 0xEA, 1, 1, 3, 3, 4, 513))),
    ("imu", sp.pack(sp.ImuPacket(7, 0xFFFFFFF0, 0x11, bytes(range(23))))),
    ("status", sp.pack(sp.Status(70000, 0x41, 99, 1, 2, 3, 4, 5, 6, 7, 8, 9, 7400, -1000, 1000, 120, 6000))),
    ("ack", sp.pack(sp.Ack(0x14, 2))),
    ("mega_time", sp.pack(sp.MegaTime(0xDEADBEEF, 1))),
    ("drive", sp.pack(sp.Drive(-1000, 250, 70300, 513))),
    ("drive_zero", sp.pack(sp.Drive(0, 0, 0, 0))),
    ("stop", sp.pack(sp.Stop())),
    ("ask_time", sp.pack(sp.AskTime(0x01020304))),
    ("ask_hello", sp.pack(sp.AskHello())),
    ("config_imu", sp.pack(sp.ConfigImu(3, 0, 7, 1, 9))),
    ("config_motors", sp.pack(sp.ConfigMotors(True, 4, 10, 6400))),
    ("servo", sp.pack(sp.Servo(1500, 0))),
    ("range", sp.pack(sp.RangePacket(65535, 0xFFFFFFF0, 5831, sp.Echo.HEARD))),
    ("range_none", sp.pack(sp.RangePacket(1, 2, 0, sp.Echo.NONE))),
    ("config_range", sp.pack(sp.ConfigRange(100))),
]

if __name__ == "__main__":
    lines = [f"{name} {payload.hex()} {sp.encode_frame(payload).hex()}" for name, payload in EXAMPLES]
    Path(__file__).with_name("serial_frames.txt").write_text("\n".join(lines) + "\n")
