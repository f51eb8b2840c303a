"""The station's connection to one robot: finds it, stays connected, hands on what arrives and sends what is asked."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from shared.messages import CameraFrame, DriveApplied, ErrorNotice, Hello, ImuBatch, Status


class LinkListener(Protocol):
    """What a link tells. Called on the event loop: return at once, hand computing to others."""

    def on_connected(self, hello: Hello) -> None: ...

    def on_disconnected(self, reason: str) -> None: ...

    def on_frame(self, frame: CameraFrame, t_station_ns: int) -> None:
        """A camera image and the station's monotonic time of its arrival."""
        ...

    def on_imu(self, batch: ImuBatch) -> None: ...

    def on_gap(self, num_samples: int) -> None:
        """IMU samples are missing between the last batch and the next one."""
        ...

    def on_drive_applied(self, applied: DriveApplied) -> None: ...

    def on_status(self, status: Status) -> None: ...

    def on_notice(self, notice: ErrorNotice) -> None:
        """The robot refused something, or a device failed."""
        ...


@dataclass(frozen=True, slots=True)
class LinkState:
    """Snapshot of a link for the API and the page. Counts run since the link was made."""

    host: str
    port: int
    connected: bool = False
    hello: Hello | None = None  # of the present or the last connection
    reason: str = "not connected yet"  # why not connected, in a sentence
    connections: int = 0  # how often a connection was made
    rtt_ms: float | None = None  # of the last heartbeat
    clock_offset_ns: int | None = None  # t_station - t_robot, now
    clock_drift_ppm: float | None = None  # the robot's clock is this much faster than the station's
    frame_rate_hz: float = 0.0  # over the last seconds
    imu_rate_hz: float = 0.0
    received_bytes_per_s: float = 0.0
    frames: int = 0
    frames_skipped: int = 0
    imu_samples: int = 0
    imu_gaps: int = 0  # how many holes
    imu_lost: int = 0  # how many samples were in them
    status: Status | None = None  # the last one
    notice: ErrorNotice | None = None  # the last one


class RobotLink:
    """Connection to the robot-server at host:port. All methods belong on the event loop that runs `run()`."""

    def __init__(
        self,
        host: str,
        port: int,
        listener: LinkListener,
        *,
        station_name: str = "station",
        now_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self._listener = listener
        self._station_name = station_name
        self._now_ns = now_ns
        self._state = LinkState(host, port)

    @property
    def state(self) -> LinkState:
        """What is known of the link now."""
        return self._state

    async def run(self) -> None:
        """Connect, and connect again whenever the connection is lost, until cancelled."""
        raise NotImplementedError

    def drive(self, linear: float, angular: float, ttl_ms: int) -> bool:
        """Hold a velocity (m/s, rad/s) for `ttl_ms` (above the protocol's limit: the limit); newest wins.

        Returns False, and sends nothing, when no robot is connected or it cannot drive.
        Raises LocalProtocolError when a number is not finite or out of the protocol's range.
        """
        raise NotImplementedError

    def stop(self) -> bool:
        """Motors off now. False when no robot is connected (its own watchdog has stopped it by then)."""
        raise NotImplementedError

    def point(self, pan: float, tilt: float) -> bool:
        """Point the camera head (rad, positive left and up); newest wins. False when there is none."""
        raise NotImplementedError

    def hijack(self, x: float, y: float, yaw: float) -> bool:
        """Put a simulated robot down elsewhere (m, m, rad). False when not connected or the robot is real."""
        raise NotImplementedError

    def to_station_ns(self, t_robot_ns: int) -> int | None:
        """The station's monotonic time of a robot time; None before the clocks are known."""
        raise NotImplementedError
