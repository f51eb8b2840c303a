"""What a link to a robot delivers, and to whom."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from shared.messages import CameraFrame, Depth, DriveApplied, ErrorNotice, Hello, ImuBatch, Status
from shared.pictures import why_not_as_announced
from station.model.frames import DriveSample


def drive_sample(applied: DriveApplied) -> DriveSample:
    """What motors and head were told, as SLAM and places want it."""
    return DriveSample(applied.t_robot_ns, applied.linear, applied.angular, applied.pan, applied.tilt)


class LinkListener(Protocol):
    """Gets what a link delivers. Called on the event loop: return at once, hand computing to others."""

    def on_connected(self, hello: Hello) -> None: ...

    def on_calibration(self, hello: Hello) -> None:
        """The robot tells another calibration from now on: its hello, with that."""
        ...

    def on_disconnected(self, reason: str) -> None: ...

    def on_frame(self, frame: CameraFrame, t_station_ns: int) -> None:
        """A camera image and the station's monotonic time of its arrival."""
        ...

    def on_imu(self, batch: ImuBatch) -> None: ...

    def on_gap(self, num_samples: int) -> None:
        """IMU samples are missing between the last batch and the next one."""
        ...

    def on_depth(self, depth: Depth) -> None: ...

    def on_drive_applied(self, applied: DriveApplied) -> None: ...

    def on_status(self, status: Status) -> None: ...

    def on_notice(self, notice: ErrorNotice) -> None:
        """The robot refused something, or a device failed."""
        ...


class IgnoringListener:
    """A LinkListener that does nothing; subclasses override what they need."""

    def on_connected(self, hello: Hello) -> None: ...

    def on_calibration(self, hello: Hello) -> None: ...

    def on_disconnected(self, reason: str) -> None: ...

    def on_frame(self, frame: CameraFrame, t_station_ns: int) -> None: ...

    def on_imu(self, batch: ImuBatch) -> None: ...

    def on_gap(self, num_samples: int) -> None: ...

    def on_depth(self, depth: Depth) -> None: ...

    def on_drive_applied(self, applied: DriveApplied) -> None: ...

    def on_status(self, status: Status) -> None: ...

    def on_notice(self, notice: ErrorNotice) -> None: ...


class LinkListeners:
    """A LinkListener that hands everything to several others, in their order."""

    def __init__(self, *listeners: LinkListener) -> None:
        self.listeners: tuple[LinkListener, ...] = listeners

    def on_connected(self, hello: Hello) -> None:
        for listener in self.listeners:
            listener.on_connected(hello)

    def on_calibration(self, hello: Hello) -> None:
        for listener in self.listeners:
            listener.on_calibration(hello)

    def on_disconnected(self, reason: str) -> None:
        for listener in self.listeners:
            listener.on_disconnected(reason)

    def on_frame(self, frame: CameraFrame, t_station_ns: int) -> None:
        for listener in self.listeners:
            listener.on_frame(frame, t_station_ns)

    def on_imu(self, batch: ImuBatch) -> None:
        for listener in self.listeners:
            listener.on_imu(batch)

    def on_gap(self, num_samples: int) -> None:
        for listener in self.listeners:
            listener.on_gap(num_samples)

    def on_depth(self, depth: Depth) -> None:
        for listener in self.listeners:
            listener.on_depth(depth)

    def on_drive_applied(self, applied: DriveApplied) -> None:
        for listener in self.listeners:
            listener.on_drive_applied(applied)

    def on_status(self, status: Status) -> None:
        for listener in self.listeners:
            listener.on_status(status)

    def on_notice(self, notice: ErrorNotice) -> None:
        for listener in self.listeners:
            listener.on_notice(notice)


class CheckedPictures(LinkListeners):
    """Hands on everything but pictures that are not what the robot announces with them."""

    def __init__(self, on_refused: Callable[[str], None], *listeners: LinkListener) -> None:
        """`on_refused` gets what is wrong with a picture, to go on a sentence that begins with its name."""
        super().__init__(*listeners)
        self._on_refused = on_refused

    def on_frame(self, frame: CameraFrame, t_station_ns: int) -> None:
        if why := why_not_as_announced(frame.jpeg, frame.width, frame.height):
            self._on_refused(why)
        else:
            super().on_frame(frame, t_station_ns)
