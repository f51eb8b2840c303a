"""A recording played again: its pictures at the pace they were taken."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import AsyncGenerator, Iterator
from pathlib import Path

from shared.mcap_recording import RecordedPicture, recorded_pictures

logger = logging.getLogger(__name__)

MAX_SILENCE_S = 0.5  # on a disk too slow for the pace, a picture is shown at least so often
MAX_PAUSE_S = 2.0  # a gap in the recording is not waited for longer


async def replay(path: Path, from_s: float = 0.0, speed: float = 1.0) -> AsyncGenerator[RecordedPicture, None]:
    """Pictures of a recording from `from_s` after its first one, `speed` times as fast as they were taken.

    A slow consumer skips to the newest picture that is due. What is not the picture that was announced is left out.
    Raises DataError when the file cannot be read.
    """
    loop = asyncio.get_running_loop()
    pictures = _shown(path)
    begun_s, begun_ns, shown_s = 0.0, 0, 0.0
    current = await asyncio.to_thread(next, pictures, None)
    while current is not None:
        following = await asyncio.to_thread(next, pictures, None)
        if current.since_first_s >= from_s:
            if not begun_ns:
                begun_s, begun_ns = loop.time(), current.t_robot_ns
            due_s = begun_s + (current.t_robot_ns - begun_ns) * 1e-9 / speed
            wait_s = due_s - loop.time()
            if wait_s > MAX_PAUSE_S:
                begun_s -= wait_s - MAX_PAUSE_S
                wait_s = MAX_PAUSE_S
            await asyncio.sleep(max(0.0, wait_s))
            behind = following is not None and (
                begun_s + (following.t_robot_ns - begun_ns) * 1e-9 / speed < loop.time()
            )  # fmt: skip
            # A disk that is too slow for the pace must not leave the viewer without any picture.
            if not behind or loop.time() - shown_s > MAX_SILENCE_S:
                yield current
                shown_s = loop.time()
        current = following


def _shown(path: Path) -> Iterator[RecordedPicture]:
    """What may be shown: an earlier station recorded whatever came."""
    said = False
    for picture in recorded_pictures(path):
        if not picture.why_unusable:
            yield picture
        elif not said:
            said = True
            logger.warning("%s: picture %d %s; such ones are not shown", path, picture.number, picture.why_unusable)
