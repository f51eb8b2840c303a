"""The Arduino Mega on its serial line: one thread reads, sorts what comes, and opens a lost line again."""

from __future__ import annotations

import asyncio
import logging
import threading
import time
from collections import deque
from collections.abc import Callable

from robot.devices.pi.mega_clock import MegaClock
from robot.devices.pi.serial_line import SerialLine
from robot.devices.ports import ImuReading
from shared.errors import DeviceLost, DeviceUnavailable, HardwareError
from shared.serial_protocol import (
    PROTOCOL_VERSION,
    AskHello,
    Command,
    ConfigImu,
    ConfigMotors,
    FirmwareMessage,
    Flag,
    Hello,
    ImuPacket,
    SerialDecoder,
    Status,
    Stop,
    encode,
    parse,
)

logger = logging.getLogger(__name__)

HELLO_TIMEOUT_S = 6.0  # the bootloader waits up to two seconds after the reset that opening the port causes
ASK_PERIOD_S = 0.5
REOPEN_PERIOD_S = 0.5
LONGEST_READ_S = 0.05  # a line's read waits no longer
SILENCE_S = 1.0  # the firmware reports ten times a second
MAX_READINGS = 225  # a second's worth, as the port says


class Mega:
    """A running firmware at the other end. Methods may be called from any thread."""

    def __init__(
        self,
        open_line: Callable[[], SerialLine],
        imu: ConfigImu,
        motors: ConfigMotors,
        now_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        """Opens the line and waits for the firmware's hello.

        Raises:
            DeviceUnavailable: no line, or nobody with our protocol at its other end.
        """
        self._open_line = open_line
        self._configs: tuple[Command, ...] = (imu, motors)
        self._now_ns = now_ns
        self._write_lock = threading.Lock()
        self._line: SerialLine | None = None
        self._decoder = SerialDecoder()
        self._clock = MegaClock()
        self._readings: deque[ImuReading] = deque(maxlen=MAX_READINGS)
        self._next_sequence = 0  # of our own count, which goes on when the Mega starts anew
        self._sequence_offset: int | None = None
        self._closed = threading.Event()
        self._waiter: tuple[asyncio.AbstractEventLoop, asyncio.Event] | None = None
        self.hello: Hello | None = None
        self.status: Status | None = None
        self.lost: str = ""  # why nothing comes at present, in a sentence
        self.restarts = 0  # how often the firmware started anew under us
        self._heard_ns = now_ns()
        self._reported = threading.Event()
        self._connect()
        self._thread = threading.Thread(target=self._run, name="mega", daemon=True)
        self._thread.start()
        self._reported.wait(SILENCE_S)  # the first status: whoever opens us may ask for the battery next

    @property
    def bad_frames(self) -> int:
        """Frames the line damaged."""
        return self._decoder.bad

    @property
    def drift_ppm(self) -> float | None:
        """Of the Mega's resonator against our clock."""
        return self._clock.drift_ppm

    def send(self, command: Command) -> None:
        """Give a command to the line. Raises DeviceLost when there is none."""
        frame = encode(command)
        with self._write_lock:
            if self._line is None:
                raise DeviceLost(self.lost or "the Mega is not connected")
            try:
                self._line.write(frame)
            except DeviceLost as exc:
                self._drop(str(exc))
                raise

    @property
    def silence_ns(self) -> int:
        """How long nothing whole has come from the Mega."""
        return self._now_ns() - self._heard_ns

    def take_readings(self) -> list[ImuReading]:
        """All samples since the last call."""
        readings = []
        while self._readings:
            readings.append(self._readings.popleft())
        return readings

    async def wait_readings(self) -> list[ImuReading]:
        """Wait for samples. Raises DeviceLost when none come for SILENCE_S."""
        event = asyncio.Event()
        self._waiter = (asyncio.get_running_loop(), event)
        try:
            while not (readings := self.take_readings()):
                try:
                    async with asyncio.timeout(SILENCE_S):  # wait_for may swallow a cancellation before Python 3.12
                        await event.wait()
                except TimeoutError:
                    raise DeviceLost(self._why_silent()) from None
                event.clear()
            return readings
        finally:
            self._waiter = None

    def close(self) -> None:
        """Stop the motors and leave the line. Safe to call twice."""
        if self._closed.is_set():
            return
        try:
            self.send(Stop())
        except HardwareError as exc:
            logger.info("no stop at closing: %s; the firmware stops by itself", exc)
        self._closed.set()
        self._thread.join(timeout=2.0)
        with self._write_lock:
            self._drop("closed")

    def _why_silent(self) -> str:
        if self.lost:
            return self.lost
        if self.status is not None and self.status.flags & Flag.IMU_MISSING:
            return "the Mega finds no ICM-20948; check its four wires (SDA 20, SCL 21, 3.3 V, GND)"
        return "the IMU gives no samples; check the wire from its INT to Mega pin 2"

    # The reading thread, and the constructor before it runs.

    def _connect(self) -> None:
        line = self._open_line()
        decoder, deadline_s = SerialDecoder(), time.monotonic() + HELLO_TIMEOUT_S
        asked_s = 0.0
        try:
            while time.monotonic() < deadline_s and not self._closed.is_set():
                if time.monotonic() - asked_s >= ASK_PERIOD_S:
                    line.write(encode(AskHello()))
                    asked_s = time.monotonic()
                for payload in decoder.receive(line.read()):
                    message = parse(payload)
                    if isinstance(message, Hello):
                        self._greet(line, message, decoder)
                        return
        except BaseException:
            line.close()
            raise
        line.close()
        heard = "damaged frames only" if decoder.bad else "nothing"
        raise DeviceUnavailable(
            f"the Mega says no hello ({heard} in {HELLO_TIMEOUT_S:.0f} s); flash it: make -C firmware upload"
        )

    def _greet(self, line: SerialLine, hello: Hello, decoder: SerialDecoder) -> None:
        if hello.version != PROTOCOL_VERSION:
            raise DeviceUnavailable(
                f"the Mega's firmware speaks protocol {hello.version}, we speak {PROTOCOL_VERSION};"
                " flash it: make -C firmware upload"
            )
        for config in self._configs:
            line.write(encode(config))
        self.hello = hello
        self._heard_ns = self._now_ns()
        self._decoder = decoder
        self._clock = MegaClock()
        self._sequence_offset = None
        with self._write_lock:
            self._line = line
            self.lost = ""

    def _run(self) -> None:
        silent_s = 0.0
        while not self._closed.is_set():
            line = self._line
            if line is None:
                self._closed.wait(REOPEN_PERIOD_S)
                self._try_reconnect()
                silent_s = 0.0
                continue
            read_ns = self._now_ns()
            try:
                data = line.read()
            except DeviceLost as exc:
                with self._write_lock:
                    self._drop(str(exc))
                continue
            now_ns = self._now_ns()
            # When this whole process stood still, the Mega was not silent: one read counts no longer than it may wait.
            silent_s += min((now_ns - read_ns) * 1e-9, LONGEST_READ_S)
            for payload in self._decoder.receive(data):
                message = parse(payload)
                if message is not None:
                    silent_s = 0.0
                    self._heard_ns = now_ns
                    self._sort(line, message, now_ns)
            if silent_s > SILENCE_S:
                with self._write_lock:
                    self._drop(f"the Mega has said nothing for {SILENCE_S:.0f} s")

    def _try_reconnect(self) -> None:
        if self._closed.is_set():
            return
        try:
            self._connect()
        except HardwareError as exc:
            self.lost = str(exc)
        else:
            self.restarts += 1
            logger.info("the Mega is back")

    def _drop(self, why: str) -> None:
        if self._line is None:
            return
        self._line.close()
        self._line = None
        self.lost = why
        logger.warning("%s", why)

    def _sort(self, line: SerialLine, message: FirmwareMessage, now_ns: int) -> None:
        if isinstance(message, ImuPacket):
            self._take_imu(message, now_ns)
        elif isinstance(message, Status):
            self.status = message
            self._reported.set()
        elif isinstance(message, Hello):
            if self.hello is not None and message.boot_id == self.hello.boot_id:
                self.hello = message  # a late answer to our asking
                return
            # The firmware has started anew: watchdog, brown-out, reset button.
            logger.warning("the Mega started anew, reset cause %d", message.reset_cause)
            self.restarts += 1
            try:
                self._greet(line, message, self._decoder)
            except HardwareError as exc:
                with self._write_lock:
                    self._drop(str(exc))

    def _take_imu(self, packet: ImuPacket, now_ns: int) -> None:
        if self._sequence_offset is None:
            # A fresh count: one number stays out, so that a hole shows.
            start = self._next_sequence + 1 if self._next_sequence else 0
            self._sequence_offset = start - packet.sequence
        sequence = packet.sequence + self._sequence_offset
        self._next_sequence = sequence + 1
        self._readings.append(
            ImuReading(
                sequence=sequence,
                t_robot_ns=self._clock.stamp(packet.t_us, now_ns),
                gyro_imu=packet.gyro_imu(),
                accel_imu=packet.accel_imu(),
            )
        )
        waiter = self._waiter
        if waiter is not None:
            try:
                waiter[0].call_soon_threadsafe(waiter[1].set)
            except RuntimeError:
                logger.debug("sample after the event loop's end")
