"""Whether a robot that speaks to us hears us too. Time is an argument."""

from __future__ import annotations

# Heartbeats are answered before anything else is sent. So late an answer, and the robot spoke on for so long with so
# many messages: it does not hear us. After a stall of the network all comes at once, and the answers right behind.
UNHEARD_AFTER_NS, UNHEARD_FOR_NS, UNHEARD_MESSAGES = 900_000_000, 250_000_000, 10


class Hearing:
    """Compares what the robot says with how late it answers heartbeats."""

    def __init__(self) -> None:
        self._answered_ns = 0  # when the last heartbeat was answered
        self._unanswered = 0  # messages that came when an answer was late already
        self._unanswered_since_ns = 0  # when the first of them came

    def note_answer(self, now_ns: int) -> None:
        """The robot heard us: it let us in, or answered a heartbeat."""
        self._answered_ns, self._unanswered = now_ns, 0

    def note_message(self, now_ns: int) -> None:
        """The robot said something, whatever it was."""
        if now_ns - self._answered_ns >= UNHEARD_AFTER_NS:
            if self._unanswered == 0:
                self._unanswered_since_ns = now_ns
            self._unanswered += 1

    def is_lost(self, now_ns: int) -> bool:
        """It speaks and does not answer: what we say is lost, or its end waits for the rest of something."""
        speaks_on = now_ns - self._unanswered_since_ns >= UNHEARD_FOR_NS
        return speaks_on and self._unanswered >= UNHEARD_MESSAGES
