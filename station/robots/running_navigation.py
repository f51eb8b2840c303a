"""A navigation from its first frame until SLAM has finished it: its recorder, its SLAM, its counts."""

from __future__ import annotations

import asyncio
from dataclasses import replace

from shared.messages import CameraFrame, Depth, DriveApplied, Hello, ImuBatch
from station.events import Notifier
from station.library.navigation_records import NavigationRecord
from station.model.frames import DepthFrame, ImageFrame
from station.robots.link_events import IgnoringListener, LinkListener, drive_sample
from station.robots.live_slam import LiveSlam
from station.robots.navigation_files import NavigationRecorder
from station.robots.slam import SlamWorker
from station.workers.slam_interface import SlamProgram


class RunningNavigation(IgnoringListener):
    """Counts what the link delivers and hands it to SLAM. All methods belong on the event loop."""

    def __init__(
        self,
        record: NavigationRecord,
        hello: Hello,
        slam: SlamWorker,
        live: LiveSlam,
        recorder: NavigationRecorder | None,
        events: Notifier,
    ) -> None:
        """`hello` is the robot's, in the run that is recorded."""
        self.record = record
        self.hello = hello
        self.slam = slam
        self.live = live
        self.recorder = recorder
        self.why_ended = ""  # the recording, in a sentence, where it was not a person who asked
        self.is_cancelled = False  # while SLAM finished it
        self._events = events
        self._is_slow = self._has_failed = False  # SLAM, the recorder: as was notified
        self._first_frame_ns: int | None = None
        self._last_frame_ns = 0
        self._frames = self._imu_samples = self._imu_lost = 0

    @property
    def listeners(self) -> tuple[LinkListener, ...]:
        """Who gets what the link delivers while it is recorded."""
        return (self,) if self.recorder is None else (self.recorder, self)

    def on_frame(self, frame: CameraFrame, t_station_ns: int) -> None:  # noqa: ARG002
        if self._first_frame_ns is None:
            self._first_frame_ns = frame.t_robot_ns
        self._last_frame_ns = frame.t_robot_ns
        image = ImageFrame(self._frames, frame.t_robot_ns, frame.exposure_ns, frame.jpeg)
        self._frames += 1
        self.slam.post(SlamProgram.add_frame, image)

    def on_imu(self, batch: ImuBatch) -> None:
        s = batch.samples
        self._imu_samples += len(s)
        gyro, accel = [x.gyro_imu for x in s], [x.accel_imu for x in s]
        is_kept = self.slam.post(SlamProgram.add_imu, [x.t_robot_ns for x in s], gyro, accel)
        if not is_kept and not self._is_slow:
            self._is_slow = True
            text = "SLAM is too slow: inertial samples wait too long and are lost to it"
            self._events.notify("slam", text, "warning")

    def on_gap(self, num_samples: int) -> None:
        self._imu_lost += num_samples

    def on_depth(self, depth: Depth) -> None:
        sensor = self.hello.calibration.depth_sensor
        if sensor is not None:
            self.slam.post(SlamProgram.add_depth, DepthFrame(depth.t_robot_ns, depth.png, sensor))

    def on_drive_applied(self, applied: DriveApplied) -> None:
        self.slam.post(SlamProgram.add_drive, drive_sample(applied))

    def counted(self) -> NavigationRecord:
        first_ns = self._first_frame_ns
        return replace(
            self.record,
            message=self.recorder_error or self.record.message,
            frames=self._frames,
            frames_skipped=self.slam.frames_dropped,
            imu_samples=self._imu_samples,
            imu_lost=self._imu_lost,
            slam_failures=self.slam.failures,
            duration_s=0.0 if first_ns is None else (self._last_frame_ns - first_ns) * 1e-9,
        )

    @property
    def left_to_do(self) -> str:
        """How far SLAM is when the recording has ended, in a sentence."""
        total = self._frames - self.slam.frames_dropped
        waiting = self.slam.frames_waiting
        if waiting:
            return f"finishing: {max(0, total - waiting)} of {total} pictures were looked at"
        return "finishing: computing trajectory and landmarks"

    @property
    def recorder_error(self) -> str:
        """Why the recording ended by itself, in a sentence; empty while it works."""
        return "" if self.recorder is None else self.recorder.error

    @property
    def slam_restarted(self) -> str:
        """What was lost with a SLAM worker that died, in a sentence."""
        if not self.slam.restarts:
            return ""
        return "SLAM was lost on the way and knows only the last part: run SLAM over the recording again for all of it"

    @property
    def slam_refused(self) -> str:
        """What SLAM could not use, in a sentence."""
        slam = self.slam
        return f"SLAM refused {slam.failures} pictures or samples: {slam.failure}" if slam.failures else ""

    async def close_recorder(self) -> None:
        """The file is complete when this returns."""
        if self.recorder is not None:
            await asyncio.to_thread(self.recorder.close)
            self.notify_recorder_error()

    def notify_recorder_error(self) -> None:
        """Once, where the recording ended by itself."""
        if self.recorder_error and not self._has_failed:
            self._has_failed = True
            self._events.notify("navigation", self.recorder_error, "error")
