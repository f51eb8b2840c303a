"""The Arduino Mega on its serial line: one thread reads, sorts what comes, and opens a lost line again."""

from __future__ import annotations

import asyncio
import logging
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

from robot.devices.mailbox import Mailbox
from robot.devices.pi.mega_clock import MegaClock
from robot.devices.pi.mega_greeting import BOOT_S, AskPlan, Settings
from robot.devices.pi.mega_health import MegaHealth
from robot.devices.pi.serial_line import SerialLine
from robot.devices.ports import ImuReading
from shared import serial_protocol as sp
from shared.errors import DeviceLost, DeviceUnavailable, HardwareError

logger = logging.getLogger(__name__)

HELLO_TIMEOUT_S = 22.0  # ten seconds for a bootloader that was spoken to, and as many after the one question
REOPEN_PERIOD_S = 0.5
LONGEST_READ_S = 0.05  # a line's read waits no longer
SILENCE_S = 1.0  # the firmware reports ten times a second
MAY_SPEAK_NS = 200_000_000  # a firmware that runs is never silent for so long
UPTIME_WRAP_MS = 1 << 32
MAX_READINGS = 225  # a second's worth, as the port says

Reading = TypeVar("Reading")


@dataclass(frozen=True, slots=True)
class ReportedUptime:
    """The Mega's clock as a report told it: `uptime_ms` when that left, so at `heard_ns` that or later."""

    boot_id: int
    uptime_ms: int
    heard_ns: int  # our monotonic clock

    def uptime_ms_at(self, t_ns: int) -> int:
        """The Mega's uptime (32 bits) at one of our times, early by as long as the report took to us, never late."""
        return (self.uptime_ms + (t_ns - self.heard_ns) // 1_000_000) & 0xFFFFFFFF


@dataclass(frozen=True, slots=True)
class RangeReading:
    """One measurement of the HC-SR04."""

    t_robot_ns: int  # when the sound turned round
    echo: int  # as `Echo` says
    echo_us: int  # there and back; 0 where none was heard


class Mega:
    """A running firmware at the other end. Methods may be called from any thread."""

    def __init__(
        self,
        open_line: Callable[[], SerialLine],
        imu: sp.ConfigImu,
        motors: sp.ConfigMotors,
        now_ns: Callable[[], int] = time.monotonic_ns,
        *,
        range_sensor: sp.ConfigRange | None = None,
    ) -> None:
        """Opens the line and waits for the firmware's hello. `range_sensor`: None: it has none.

        Raises:
            DeviceUnavailable: no line, or nobody with our protocol at its other end.
        """
        self._open_line = open_line
        self._settings = Settings(imu, motors, range_sensor)
        self._health = MegaHealth()
        self._now_ns = now_ns
        self._write_lock = threading.Lock()
        self._line: SerialLine | None = None
        self._given_up: list[SerialLine] = []  # the reading thread closes them: whoever drives must not wait for that
        self._new_start: AskPlan | None = None  # the firmware started anew and has not been greeted yet
        self._decoder = sp.SerialDecoder()
        self._clock = MegaClock()
        self._readings: Mailbox[ImuReading] = Mailbox(MAX_READINGS)
        self._ranges: Mailbox[RangeReading] = Mailbox(1)
        self._next_sequence = 0  # of our own count, which goes on when the Mega starts anew
        self._sequence_offset: int | None = None
        self._closed = threading.Event()
        self.hello: sp.Hello | None = None
        self.status: sp.Status | None = None
        self._uptime_ms = 0
        self._reported: ReportedUptime | None = None  # by the firmware behind the present line
        self.lost: str = ""  # why nothing comes at present, in a sentence
        self.restarts = 0  # how often the firmware started anew under us
        self._heard_ns = now_ns()
        self._ready = threading.Event()  # reported once, and all settings confirmed
        self._connect()
        self._thread = threading.Thread(target=self._run, name="mega", daemon=True)
        self._thread.start()
        self._ready.wait(2 * SILENCE_S)  # whoever opens us may drive or ask for the battery next

    def problems(self) -> dict[str, str]:
        """What goes wrong on the Mega although it answers: name → sentence."""
        if self.lost:
            return {}
        refused = {"settings": self._settings.refused} if self._settings.refused else {}
        return self._health.sentences() | refused

    def send(self, command: sp.Stop | sp.Servo) -> None:
        """Give a command to the line; never waits for it.

        Raises:
            DeviceLost: there is no line, or the firmware behind it is not known to be the one we have set.
        """
        with self._write_lock:
            self._write(command)

    def drive(self, left: int, right: int, until_ns: int) -> None:
        """Give a drive command to the line; never waits for it.

        Args:
            left, right: permille of full duty.
            until_ns: when it ends, by our monotonic clock. The Mega is told in its own, and refuses what comes later.
        Raises:
            DeviceLost: as for `send`; or the Mega's settings or clock are not known yet.
        """
        with self._write_lock:
            if not self._settings.motors_are_set:
                raise DeviceLost(self._settings.refused or self.lost or "the Mega has not confirmed its settings yet")
            if self._reported is None:
                raise DeviceLost(self.lost or "the Mega has not reported its clock yet")
            self._write(sp.Drive(left, right, self._reported.uptime_ms_at(until_ns), self._reported.boot_id))

    def _write(self, command: sp.Command) -> None:
        if self._line is None:
            raise DeviceLost(self.lost or "the Mega is not connected")
        if self._new_start is not None:
            raise DeviceLost("the Mega has started anew; its motors are off until it has been greeted")
        try:
            self._line.write(sp.encode(command))
        except DeviceLost as exc:
            self._drop(str(exc))
            raise

    @property
    def silence_ns(self) -> int:
        """How long nothing whole has come from the Mega."""
        return self._now_ns() - self._heard_ns

    async def wait_readings(self) -> list[ImuReading]:
        """All samples since the last call, at least one.

        Raises:
            DeviceLost: the line is lost, or the Mega has run for SILENCE_S by its own clock and taken none. An emulated
                Mega on a busy machine runs slower than ours: its sensor gets the time that it gets.
        """
        return await self._wait(self._readings, self._why_silent)

    async def wait_range(self) -> RangeReading:
        """The next measurement of the range sensor. Raises DeviceLost as `wait_readings` does."""
        return (await self._wait(self._ranges, self._why_no_range))[-1]

    async def _wait(self, mailbox: Mailbox[Reading], why_silent: Callable[[], str]) -> list[Reading]:
        asked_ms = self._uptime_ms
        while True:
            try:
                async with asyncio.timeout(SILENCE_S):  # wait_for may swallow a cancellation before Python 3.12
                    return await mailbox.get()
            except TimeoutError:
                ran_ms = self._uptime_ms - asked_ms
                if self.lost or not 0 <= ran_ms < SILENCE_S * 1e3:
                    raise DeviceLost(why_silent()) from None

    def close(self) -> None:
        """Stop the motors and leave the line. Safe to call twice."""
        if self._closed.is_set():
            return
        try:
            self.send(sp.Stop())
        except HardwareError as exc:
            logger.info("no stop at closing: %s; the firmware stops by itself", exc)
        self._closed.set()
        self._thread.join(timeout=2.0)
        with self._write_lock:
            self._drop("closed")
        self._close_given_up()

    def _why_silent(self) -> str:
        if self.lost:
            return self.lost
        if self.status is not None and self.status.flags & sp.Flag.IMU_MISSING:
            return "the Mega finds no ICM-20948; check its four wires (SDA 20, SCL 21, 3.3 V, GND)"
        return "the IMU gives no samples; check the wire from its INT to Mega pin 2"

    def _why_no_range(self) -> str:
        if self._settings.is_older:
            return "the Mega's firmware is too old for an HC-SR04; flash it: make -C firmware upload"
        return self.lost or "the Mega measures no range; restart robot-server"

    # The reading thread, and the constructor before it runs.

    def _connect(self) -> None:
        line = self._open_line()
        opened_s = time.monotonic()
        decoder, plan = sp.SerialDecoder(), AskPlan(opened_s)
        try:
            while (now_s := time.monotonic()) < opened_s + HELLO_TIMEOUT_S and not self._closed.is_set():
                if plan.is_due(now_s):
                    line.write(sp.encode(sp.AskHello()))
                for payload in decoder.receive(line.read()):
                    message = sp.parse(payload)
                    if isinstance(message, sp.Hello):
                        self._greet(line, message, decoder)
                        return
                    if message is not None:
                        plan.hear(time.monotonic())
        except BaseException:
            line.close()
            raise
        line.close()
        heard = "damaged frames only" if decoder.bad else "nothing"
        raise DeviceUnavailable(
            f"the Mega says no hello ({heard} in {HELLO_TIMEOUT_S:.0f} s); flash it: make -C firmware upload"
        )

    def _greet(self, line: SerialLine, hello: sp.Hello, decoder: sp.SerialDecoder) -> None:
        if hello.version != sp.PROTOCOL_VERSION:
            raise DeviceUnavailable(
                f"the Mega's firmware speaks protocol {hello.version}, we speak {sp.PROTOCOL_VERSION};"
                " flash it: make -C firmware upload"
            )
        self._settings.begin()
        self._say_settings(line)
        self.hello = hello
        self._uptime_ms = 0
        self._heard_ns = self._now_ns()
        self._decoder = decoder
        self._clock = MegaClock()
        self._sequence_offset = None
        with self._write_lock:
            self._line = line
            self._reported = None
            self._new_start = None
            self.lost = ""

    def _say_settings(self, line: SerialLine) -> None:
        for command in self._settings.due(time.monotonic()):
            line.write(sp.encode(command))

    def _run(self) -> None:
        while not self._closed.is_set():
            try:
                self._serve_line()
            except HardwareError as exc:
                self._lose(str(exc))
            except Exception as exc:  # whatever it is: a dead thread would leave the robot deaf for good
                logger.exception("the Mega's line")
                self._lose(f"the Mega's line failed ({type(exc).__name__}: {exc}); opening it again")

    def _lose(self, why: str) -> None:
        with self._write_lock:
            self._drop(why)
            self.lost = why

    def _serve_line(self) -> None:
        """Read one line until it is lost; open it again when there is none."""
        line = self._line
        self._close_given_up()  # after that look: the port has one owner, and a line given up still holds its lock
        if line is None:
            self._closed.wait(REOPEN_PERIOD_S)
            if not self._closed.is_set():
                self._connect()
                self.restarts += 1
                logger.info("the Mega is back")
            return
        silent_s = 0.0
        while self._line is line and not self._closed.is_set():
            read_ns = self._now_ns()
            data = line.read()
            now_ns = self._now_ns()
            # When this whole process stood still, the Mega was not silent: one read counts no longer than it may wait.
            silent_s += min((now_ns - read_ns) * 1e-9, LONGEST_READ_S)
            for payload in self._decoder.receive(data):
                message = sp.parse(payload)
                if message is not None:
                    silent_s = 0.0
                    self._heard_ns = now_ns
                    self._sort(line, message, now_ns)
            self._say_what_is_due(line)
            if silent_s > SILENCE_S:
                raise DeviceLost(f"the Mega has said nothing for {SILENCE_S:.0f} s")

    def _say_what_is_due(self, line: SerialLine) -> None:
        if self._new_start is not None:
            if self._new_start.is_due(time.monotonic()):
                line.write(sp.encode(sp.AskHello()))
        elif self.silence_ns < MAY_SPEAK_NS:  # else it may be in its bootloader
            self._say_settings(line)

    def _drop(self, why: str) -> None:
        if self._line is None:
            return
        self._given_up.append(self._line)
        self._line = None
        self._new_start = None
        self.lost = why
        logger.warning("%s", why)

    def _close_given_up(self) -> None:
        while self._given_up:
            self._given_up.pop().close()

    def _sort(self, line: SerialLine, message: sp.FirmwareMessage, now_ns: int) -> None:
        if self._new_start is not None and not isinstance(message, sp.Hello):
            self._new_start.hear(time.monotonic())
        if isinstance(message, sp.ImuPacket):
            self._take_imu(message, now_ns)
        elif isinstance(message, sp.RangePacket):
            t_robot_ns = self._clock.at(message.t_us, now_ns)
            self._ranges.put(RangeReading(t_robot_ns, message.echo, message.echo_us))
        elif isinstance(message, sp.Status):
            self._take_status(message, now_ns)
        elif isinstance(message, sp.Ack):
            self._settings.take(message)
            self._health.take_ack(message)
            self._note_ready()
        elif isinstance(message, sp.Hello):
            if self._new_start is None and self.hello is not None and message.boot_id == self.hello.boot_id:
                self.hello = message  # a late answer to our asking, or said once more before it heard us
                return
            # The firmware has started anew: watchdog, brown-out, reset button.
            logger.warning("the Mega started anew, reset cause %d", message.reset_cause)
            self.restarts += 1
            self._greet(line, message, self._decoder)

    def _take_status(self, status: sp.Status, now_ns: int) -> None:
        self.status = status
        before_ms, self._uptime_ms = self._uptime_ms, status.uptime_ms
        self._health.take(status)
        has_fallen = 0 < before_ms - status.uptime_ms < UPTIME_WRAP_MS // 2  # by more: it went round, after 49.7 days
        if has_fallen and self._new_start is None:
            # A new start whose hello was lost, or the same boot number after a power cut: the settings are gone.
            logger.warning("the Mega's uptime fell: it started anew")
            with self._write_lock:
                self._new_start = AskPlan(time.monotonic() - BOOT_S)
            self._new_start.hear(time.monotonic())
        if self.hello is not None:
            self._reported = ReportedUptime(self.hello.boot_id, status.uptime_ms, now_ns)
        self._note_ready()

    def _note_ready(self) -> None:
        if self.status is not None and self._settings.are_confirmed:
            self._ready.set()

    def _take_imu(self, packet: sp.ImuPacket, now_ns: int) -> None:
        if self._sequence_offset is None:
            # A fresh count: one number stays out, so that a hole shows.
            start = self._next_sequence + 1 if self._next_sequence else 0
            self._sequence_offset = start - packet.sequence
        sequence = packet.sequence + self._sequence_offset
        self._next_sequence = sequence + 1
        t_robot_ns = self._clock.stamp(packet.t_us, now_ns)
        self._readings.put(ImuReading(sequence, t_robot_ns, packet.gyro_imu(), packet.accel_imu()))
