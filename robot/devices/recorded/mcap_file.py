"""A recording that a station made, played as the robot that it was made of."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from robot.devices.ports import ImuReading
from robot.devices.recorded.recording import RecordedFrame, Recording
from shared.errors import DataError
from shared.mcap_recording import HELLO_TOPIC, InOrder, McapContent, mcap_images


def open_file(path: Path) -> Recording:
    """Open an MCAP recording. Raises DataError where it is not one of ours, or holds nothing to play."""
    content = McapContent(path)
    if content.hello is None:
        raise DataError(f"{path} holds no {HELLO_TOPIC}; only recordings made by a station can be played")
    if not content.frames and not content.samples:
        raise DataError(f"{path} holds neither images nor IMU samples; nothing to play")
    images = InOrder(lambda: mcap_images(path))
    frames = tuple(
        RecordedFrame(t_ns, path, exposure_ns, partial(images.read, number))
        for number, (t_ns, exposure_ns) in enumerate(content.frames)
    )
    samples = tuple(
        ImuReading(sequence, t_ns, (wx, wy, wz), (ax, ay, az))
        for sequence, (t_ns, (wx, wy, wz, ax, ay, az)) in enumerate(content.samples)
    )
    remarks = [f"{content.unusable_samples} IMU samples of {path} are no numbers and are left out"]
    return Recording(
        path, content.hello.calibration, frames, samples, tuple(remarks if content.unusable_samples else ())
    )
