"""The motors' guard: they run only while fresh commands keep coming, whatever else in this process hangs or fails.

`DriveGuard` decides, with time as an argument. `MotorWatchdog` is the thread that makes it true; nobody else touches
the motors. Every fresh command reaches them, also an unchanged one, so that the station feeds the firmware's watchdog.
Each goes with its end: this process may be stopped between its look at the clock and its word to the motors, and what
they hear after its end moves nothing.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

from robot.devices.ports import Motors
from shared.errors import HardwareError
from shared.messages import MAX_DRIVE_TTL_MS

logger = logging.getLogger(__name__)

MAX_TTL_NS = MAX_DRIVE_TTL_MS * 1_000_000
LATEST_CHECK_S = 0.05  # the thread looks at the clock at least so often, even if a wake-up was lost
# A word is at the motors' pins by then: the line takes 1 ms, the firmware's loop a few, and its clock ends motions some
# ms early. What finds them at rest there starts them, if for a millisecond; what is over by then moves nothing.
AT_THE_PINS_NS = 10_000_000
# Motors end a word before its time: the Mega is told its end early by as long as its last report took to us, 12 ms in a
# process that a camera held up (docs/studies/stop.md). Twice that before the end of what was told last they may rest.
ENDS_EARLY_NS = 30_000_000
STUCK_NS = 1_000_000_000  # a thread that has not looked for so long hangs in the motors' driver


@dataclass(frozen=True, slots=True)
class Velocity:
    """What the motors are told to hold."""

    linear_m_s: float = 0.0
    angular_rad_s: float = 0.0

    @property
    def is_zero(self) -> bool:
        return self.linear_m_s == 0.0 and self.angular_rad_s == 0.0


STANDSTILL = Velocity()


class DriveGuard:
    """The one wish that holds, and until when. Starts at standstill; after `close` it stays there."""

    def __init__(self) -> None:
        self._wish = STANDSTILL
        self._until_ns = 0
        self._closed = False
        self.starts_until_ns = 0  # from then on the wish keeps motors moving that move, and starts none
        self.num_commands = 0
        self.stops = 0  # how often silence ended a motion

    def command(self, wish: Velocity, until_ns: int, now_ns: int, starts_until_ns: int | None = None) -> bool:
        """Hold a velocity until a time, MAX_TTL_NS from now at most; what has lived already moves nothing.

        `starts_until_ns`: from then on it starts no motors that rest; by default right before its end. False after
        `close`.
        """
        if self._closed:
            return False
        goes_on = not self.velocity(now_ns).is_zero and self._until_ns - now_ns > ENDS_EARLY_NS
        until_ns = min(until_ns, now_ns + MAX_TTL_NS)
        reaches_pins_ns = until_ns - AT_THE_PINS_NS
        starts_until_ns = reaches_pins_ns if starts_until_ns is None else min(starts_until_ns, reaches_pins_ns)
        if wish.is_zero or now_ns < starts_until_ns or (goes_on and until_ns > now_ns):
            self._wish = wish
            self._until_ns = until_ns
            self.starts_until_ns = starts_until_ns
            self.num_commands += 1
        return True

    def stop(self) -> None:
        """Forget the wish; the next command counts again."""
        self._wish = STANDSTILL

    def close(self) -> None:
        """Stop for good."""
        self._closed = True
        self.stop()

    @property
    def until_ns(self) -> int:
        """When the wish ends."""
        return self._until_ns

    def velocity(self, now_ns: int) -> Velocity:
        """What the motors must be told now. Silence beyond the time to live is a stop."""
        if not self._wish.is_zero and now_ns >= self._until_ns:
            self._wish = STANDSTILL
            self.stops += 1
        return self._wish

    def next_deadline_ns(self) -> int | None:
        """When `velocity` will change by itself."""
        return None if self._wish.is_zero else self._until_ns


class MotorWatchdog:
    """Owns the motors and a thread of its own. Methods may be called from any thread."""

    def __init__(
        self,
        motors: Motors,
        on_applied: Callable[[Velocity], None] | None = None,
        now_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self._motors = motors
        self._on_applied = on_applied  # called from the watchdog's thread on each change
        self._now_ns = now_ns
        self._guard = DriveGuard()
        self._changed = threading.Condition()
        self._closed = False
        self._applied = STANDSTILL
        self._looked_ns = now_ns()
        self._told_commands = 0  # how many commands the motors have been told
        self._told_until_ns = 0  # when the last word that they took ends
        self.fault = ""  # why the motors do not obey, in a sentence
        self.stop_fault = ""  # why the motors did not take the last stop, in a sentence
        self._stop_motors()  # whatever ran here before may have left them running
        self._thread = threading.Thread(target=self._run, name="motor-watchdog", daemon=True)
        self._thread.start()

    @property
    def stops(self) -> int:
        """How often silence ended a motion."""
        return self._guard.stops

    @property
    def applied(self) -> Velocity:
        """What the motors were told last."""
        return self._applied

    @property
    def is_working(self) -> bool:
        """Whether our thread lives and has looked at the clock lately."""
        return self._thread.is_alive() and self._now_ns() - self._looked_ns < STUCK_NS

    def command(self, wish: Velocity, until_ns: int, starts_until_ns: int | None = None) -> bool:
        """Hold a velocity until a monotonic time. False when closed or when our thread died: then nothing may move.

        Times, not durations: this process may have been stopped since the caller looked at the clock.
        `starts_until_ns`: from then on it starts no motors that rest; by default right before its end.
        """
        if not self._thread.is_alive():
            self._stop_motors()
            return False
        with self._changed:
            accepted = self._guard.command(wish, until_ns, self._now_ns(), starts_until_ns)
            self._changed.notify()
        return accepted

    def stop(self) -> None:
        """Motors off now; does not wait for a thread that hangs in a driver."""
        with self._changed:
            self._guard.stop()
            self._changed.notify()
        # The thread stops them as well, after anything it is telling them at this moment.
        self._stop_motors()

    def check(self) -> None:
        """Stop the motors from the caller's thread when ours hangs in a driver, or when they took no stop.

        Call it regularly from elsewhere.
        """
        with self._changed:
            must_rest = self._guard.velocity(self._now_ns()).is_zero
        if must_rest and (self.stop_fault or not self._applied.is_zero):
            self._stop_motors()

    def close(self) -> None:
        """Stop for good and end the thread. Safe to call twice."""
        with self._changed:
            self._guard.close()
            self._closed = True
            self._changed.notify()
        self._stop_motors()
        self._thread.join(timeout=1.0)
        self._stop_motors()

    def _stop_motors(self) -> None:
        self.stop_fault = self._motors.stop()

    def _run(self) -> None:
        try:
            while not self._closed:
                self._apply_once()
        except Exception as exc:
            logger.exception("motor watchdog")
            self.fault = f"the motors' watchdog failed ({type(exc).__name__}: {exc}); restart robot-server"
        finally:
            self._stop_motors()
            self._note(STANDSTILL)

    def _apply_once(self) -> None:
        self._looked_ns = self._now_ns()
        with self._changed:
            if not self._is_due() and not self._closed:
                self._changed.wait(self._time_to_wait_s())
            is_due = self._is_due()
            # This thread may have waited until the word before has ended at the motors, and this one starts none now.
            now_ns = self._now_ns()
            motors_may_rest = self._told_until_ns - now_ns <= ENDS_EARLY_NS
            if is_due and motors_may_rest and now_ns >= self._guard.starts_until_ns:
                self._guard.stop()
            velocity, until_ns = self._guard.velocity(self._now_ns()), self._guard.until_ns
            self._told_commands = self._guard.num_commands
        # Outside the lock: a driver that blocks must not keep `stop` from being called.
        if is_due:
            self._tell(velocity, until_ns)

    def _is_due(self) -> bool:
        velocity = self._guard.velocity(self._now_ns())
        return velocity != self._applied or (not velocity.is_zero and self._told_commands != self._guard.num_commands)

    def _time_to_wait_s(self) -> float:
        deadline_ns = self._guard.next_deadline_ns()
        if deadline_ns is None:
            return LATEST_CHECK_S
        return min(LATEST_CHECK_S, max(0.0, (deadline_ns - self._now_ns()) * 1e-9))

    def _tell(self, velocity: Velocity, until_ns: int) -> None:
        try:
            if velocity.is_zero:
                self._told_until_ns = 0
                self._stop_motors()
            else:
                self._motors.drive(velocity.linear_m_s, velocity.angular_rad_s, until_ns)
                self._told_until_ns = until_ns
                self.stop_fault = ""  # whoever obeys has no stop before it
        except HardwareError as exc:
            if not self.fault:
                logger.error("motors do not obey: %s", exc)
            self.fault = f"motors do not obey: {exc}"
            with self._changed:
                self._guard.stop()
            self._told_until_ns = 0
            self._stop_motors()
            velocity = STANDSTILL
        else:
            self.fault = ""
        self._note(velocity)

    def _note(self, velocity: Velocity) -> None:
        has_changed = velocity != self._applied
        self._applied = velocity
        if has_changed and self._on_applied is not None:
            self._on_applied(velocity)
