"""Runs a backend over a recorded navigation and measures what it cost."""

from __future__ import annotations

import dataclasses
import hashlib
import logging
import time
from collections.abc import Callable, Iterator

import numpy as np

from shared.errors import DataError
from station.model.frames import DepthFrame, DriveSample, ImageFrame, ImuBatch
from station.model.navigation import Navigation
from station.model.slam_update import SlamUpdate
from station.slam.backend import SlamBackend
from station.slam.mapping.depth import DepthLog, with_depth

logger = logging.getLogger(__name__)

Events = Iterator[ImuBatch | DriveSample | DepthFrame | ImageFrame]


def run_backend(
    backend: SlamBackend,
    events: Events,
    on_update: Callable[[SlamUpdate], None] | None = None,
    before_finish: Callable[[], None] | None = None,
) -> Navigation:
    """Feed everything in sensor-time order, finish, fill in wall and CPU time, and name the navigation by its content.

    Raises:
        EstimationError: nothing could be reconstructed; says why.
    """
    depth = DepthLog()
    wall_begin, cpu_begin = time.perf_counter(), time.process_time()
    for event in events:
        if isinstance(event, ImageFrame):
            update = backend.add_frame(event)
            if on_update is not None:
                on_update(update)
        elif isinstance(event, ImuBatch):
            backend.add_imu(event)
        elif isinstance(event, DepthFrame):
            try:
                depth.add(event)
            except DataError as exc:  # the images make a map without it
                logger.warning("%s; it is left out", exc)
        else:
            backend.add_drive(event)
    if before_finish is not None:
        before_finish()
    nav = with_depth(backend.finish(), depth)
    wall = time.perf_counter() - wall_begin
    report = dataclasses.replace(
        nav.report,
        wall_s=wall,
        realtime_factor=nav.report.duration_s / wall if wall > 0 else 0.0,
        cpu_s=time.process_time() - cpu_begin,
    )
    return dataclasses.replace(nav, id=f"{nav.id}-{content_digest(nav)}", report=report)


def content_digest(nav: Navigation) -> str:
    """Twelve digits that two navigations share only when images, poses and landmarks are the same.

    First stamps are no names: recordings of images without a clock all begin at 0.
    """
    digest = hashlib.sha256()
    for array in (nav.keyframes.t_robot_ns, nav.keyframes.T_world_cam, nav.landmarks.p_world):
        digest.update(np.ascontiguousarray(array).tobytes())
    for encoded in nav.keyframes.encoded:
        digest.update(len(encoded).to_bytes(8, "big") + encoded)
    return digest.hexdigest()[:12]
