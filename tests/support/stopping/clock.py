"""A program whose wall clock can be set while it runs, as it sees it through the C library (clock_shift.c)."""

from __future__ import annotations

import mmap
import struct
import subprocess
from pathlib import Path

from shared.errors import DeviceUnavailable

SOURCE = Path(__file__).with_name("clock_shift.c")
NS = 1_000_000_000


class SettableClock:
    """The wall clock of one program and its children. Monotonic clocks are as they are."""

    def __init__(self, folder: Path, name: str) -> None:
        """Builds what the program is started with. Raises DeviceUnavailable without a C compiler."""
        library, file = folder / "clock_shift.so", folder / f"{name}-clock"
        if not library.exists():
            command = ["gcc", "-O2", "-shared", "-fPIC", "-o", str(library), str(SOURCE), "-ldl"]
            try:
                subprocess.run(command, check=True, capture_output=True)
            except (OSError, subprocess.CalledProcessError) as exc:
                raise DeviceUnavailable(
                    f"tests/support/stopping/clock_shift.c cannot be built ({exc}); run firmware/install-deps.sh"
                ) from exc
        file.write_bytes(bytes(8))
        with file.open("r+b") as opened:
            self._shift = mmap.mmap(opened.fileno(), 8)
        self.environment = {"LD_PRELOAD": str(library), "SENTINEL_CLOCK_SHIFT": str(file)}

    @property
    def shift_s(self) -> float:
        """By how much it is wrong."""
        return float(struct.unpack("<q", self._shift[:8])[0]) / NS

    def jump(self, shift_s: float) -> None:
        """Set it so much off the true one, at once."""
        self._shift[:8] = struct.pack("<q", round(shift_s * NS))

    def close(self) -> None:
        self._shift.close()
