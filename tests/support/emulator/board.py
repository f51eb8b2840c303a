"""Runs the emulated board: the real firmware in virtual time, from a script, into files."""

from __future__ import annotations

import fcntl
import json
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

from shared import serial_protocol as sp
from tests.support.paths import ROOT

ELF = ROOT / "firmware" / "build" / "sentinel.elf"
BOOTLOADER = Path("/usr/share/arduino/hardware/arduino/avr/bootloaders/stk500v2/stk500boot_v2_mega2560.hex")
BOARD = ROOT / "firmware" / "build" / "emulator" / "board"


def missing_reason() -> str | None:
    """Why the emulated board cannot be built here, or None."""
    if shutil.which("avr-g++") is None or not Path("/usr/share/arduino/hardware/arduino/avr").is_dir():
        return "emulated firmware tests need gcc-avr and arduino-core-avr: run firmware/install-deps.sh"
    if not Path("/usr/include/simavr/sim_avr.h").is_file():
        return "emulated firmware tests need libsimavr-dev and libelf-dev: run firmware/install-deps.sh"
    return None


def build() -> None:
    """Builds firmware and board; another process that is just building them is waited for."""
    ELF.parent.mkdir(exist_ok=True)
    with (ELF.parent / ".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        run = subprocess.run(["make", "-s", "-C", str(ROOT / "firmware"), "emulator"], capture_output=True, text=True)
    if run.returncode != 0:
        raise RuntimeError(f"firmware build failed:\n{run.stdout}{run.stderr}")


@dataclass(frozen=True)
class Run:
    """What a batch run left."""

    stream: bytes  # all the Mega sent
    pins: list[tuple[int, int, int]]  # t_us, left, right permille at the driver's inputs, on change
    events: list[tuple[int, str]]  # t_us, text
    facts: dict[str, float]

    def messages(self, stream: bytes | None = None) -> list[sp.FirmwareMessage]:
        decoder = sp.SerialDecoder()
        parsed = [sp.parse(p) for p in decoder.receive(self.stream if stream is None else stream)]
        return [m for m in parsed if m is not None]

    def imu(self) -> list[sp.ImuPacket]:
        return [m for m in self.messages() if isinstance(m, sp.ImuPacket)]

    def statuses(self) -> list[sp.Status]:
        return [m for m in self.messages() if isinstance(m, sp.Status)]

    def duty_at(self, t_us: float) -> tuple[int, int]:
        """Permille in the last window that ended at or before t_us."""
        at = [(left, right) for t, left, right in self.pins if t <= t_us]
        return at[-1] if at else (0, 0)

    def stopped_after(self, t_us: float) -> float:
        """Microseconds from t_us until both motors were at zero and stayed there."""
        moving = [t for t, left, right in self.pins if (left or right) and t > t_us]
        zeros = [t for t, left, right in self.pins if not (left or right) and t > (moving[-1] if moving else t_us)]
        return zeros[0] - t_us if zeros else 0.0


def batch(
    folder: Path, seconds: float, script: list[tuple[float, str]] | None = None, *, boot: Path | None = None
) -> Run:
    """Runs `seconds` of virtual time, from the bootloader `boot` on. Script: (second, command) pairs, see board.c."""
    folder.mkdir(parents=True, exist_ok=True)
    script_file, out, pins = folder / "script", folder / "uart", folder / "pins"
    script_file.write_text("".join(f"{t * 1e6:.0f} {line}\n" for t, line in sorted(script or [], key=lambda s: s[0])))
    options: list[str | Path] = ["--out", out, "--pins", pins, "--script", script_file, "--seconds", str(seconds)]
    if boot is not None:
        options += ["--boot", boot]
    run = subprocess.run(
        [BOARD, "--elf", ELF, *options],
        capture_output=True,
        text=True,
        timeout=240 + 20 * seconds,  # a busy PC runs the board slower than real time
    )
    assert run.returncode == 0, run.stdout + run.stderr
    lines = run.stdout.splitlines()
    events = [line.split(" ", 3) for line in lines if line.startswith("E ")]
    return Run(
        stream=out.read_bytes(),
        pins=[(int(t), int(left), int(right)) for t, left, right in (p.split() for p in pins.read_text().splitlines())],
        events=[(int(t), text) for _, t, _, text in events],
        facts=json.loads(lines[-1]),
    )


def uart(command: sp.Command) -> str:
    """Script line that sends a command to the Mega."""
    return f"uart {sp.encode(command).hex()}"


def drive(
    seconds: list[float], left: int, right: int, ttl_ms: int = 250, *, boot_id: int = 1, booted_s: float = 0.0
) -> list[tuple[float, str]]:
    """Drive commands at these times, each to end so much later by the uptime of a boot that began at `booted_s`."""
    ends_ms = [round(1000 * (t - booted_s)) + ttl_ms & 0xFFFFFFFF for t in seconds]
    return [(t, uart(sp.Drive(left, right, end, boot_id))) for t, end in zip(seconds, ends_ms, strict=True)]


def symbol(name: str) -> int:
    """RAM address of a firmware variable."""
    lines = subprocess.run(["avr-nm", str(ELF)], capture_output=True, text=True, check=True).stdout.splitlines()
    found = [line.split()[0] for line in lines if line.split()[-1] == name]
    return int(found[0], 16) & 0xFFFF
