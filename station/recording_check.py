"""Whether a recording is what was written: every chunk against its checksum, the count against its summary."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from mcap.reader import make_reader
from mcap.records import Message
from mcap.stream_reader import StreamReader

from shared.errors import DataError
from shared.mcap_recording import DAMAGE, MAX_RECORD_BYTES


@dataclass(frozen=True, slots=True)
class RecordingCheck:
    """What a look at every byte of a recording found."""

    path: Path
    messages: int  # that can be read, up to the first damage
    seconds: float
    size: int  # bytes
    damage: str  # in words; empty: none
    is_cut: bool  # it has no end: `station recordings recover` gives it one

    def __str__(self) -> str:
        amount = f"{self.seconds:.1f} s, {self.messages} messages, {self.size / 1e6:.1f} MB"
        if not self.damage:
            return f"{self.path}: whole, {amount}"
        remedy = f"; `station recordings recover {self.path}` makes it a proper file of these" if self.is_cut else ""
        return f"{self.path}: {self.damage}; readable: {amount}{remedy}"


def check_recording(path: Path) -> RecordingCheck:
    """Read a recording from end to end.

    Raises:
        DataError: it cannot be read at all (permissions, a failing disk).
    """
    messages, first_ns, last_ns, damage = 0, 0, 0, ""
    expected: int | None = None
    try:
        size = path.stat().st_size
        with path.open("rb") as file:
            try:
                summary = make_reader(file).get_summary()
                if summary is not None and summary.statistics is not None:
                    expected = summary.statistics.message_count
            except DAMAGE:
                pass  # told below: it has no end
            file.seek(0)
            try:
                for record in StreamReader(file, validate_crcs=True, record_size_limit=MAX_RECORD_BYTES).records:
                    if isinstance(record, Message):
                        first_ns = record.log_time if not messages else min(first_ns, record.log_time)
                        last_ns = max(last_ns, record.log_time)
                        messages += 1
            except DAMAGE as exc:
                damage = f"damaged ({str(exc) or type(exc).__name__})"
    except OSError as exc:
        raise DataError(f"{path} cannot be read ({exc.strerror}); check its permissions and the disk") from exc
    if expected is None:
        damage = "it has no end: its writer was killed, or the file was cut"
    elif not damage and messages != expected:
        damage = f"damaged ({messages} of {expected} messages are there)"
    return RecordingCheck(path, messages, (last_ns - first_ns) * 1e-9, size, damage, expected is None)
