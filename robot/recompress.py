"""A JPEG again with another quality, in a thread of its own. The only file that knows what does it."""

from __future__ import annotations

import asyncio
import io
import logging
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor

from robot.video import Picture

logger = logging.getLogger(__name__)


class Recompressor:
    """Makes pictures smaller in the background, one at a time. Methods belong on the event loop.

    What is late by its turn is left out: no station sends it any more. A station asks for its next picture when the
    last one is made or late, so each has one waiting at most.
    """

    def __init__(self, on_made: Callable[[], None], now_ns: Callable[[], int]) -> None:
        self._on_made = on_made
        self._now_ns = now_ns
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="recompress")
        self._waiting: deque[tuple[Picture, int]] = deque()
        self._is_busy = False

    def begin(self, picture: Picture, quality: int) -> None:
        """Make `picture.smaller[quality]`."""
        self._waiting.append((picture, quality))
        self._forget_late()
        if not self._is_busy:
            self._make_next()

    def _make_next(self) -> None:
        self._forget_late()
        self._is_busy = bool(self._waiting)
        if not self._is_busy:
            return
        loop = asyncio.get_running_loop()
        picture, quality = self._waiting.popleft()

        def keep(smaller: bytes) -> None:
            picture.smaller[quality] = smaller
            self._make_next()
            self._on_made()

        def hand_over(made: Future[bytes]) -> None:
            if not made.cancelled() and not loop.is_closed():
                loop.call_soon_threadsafe(keep, made.result())

        self._thread.submit(_smaller_or_whole, picture.frame.jpeg, quality).add_done_callback(hand_over)

    def _forget_late(self) -> None:
        now_ns = self._now_ns()
        self._waiting = deque(job for job in self._waiting if not job[0].is_late(now_ns))

    def close(self) -> None:
        self._waiting.clear()  # what is being made now would begin the next
        self._thread.shutdown(wait=False, cancel_futures=True)


def _smaller_or_whole(jpeg: bytes, quality: int) -> bytes:
    """What a library makes of a damaged picture is not known: the pictures behind it wait for this one's end."""
    try:
        return recompress(jpeg, quality)
    except Exception:
        logger.exception("a picture could not be made smaller")
        return jpeg


def recompress(jpeg: bytes, quality: int) -> bytes:
    """The picture at this quality; as it was where that makes it no smaller, or where nothing here can do it.

    Its code tables are made for it, which saves a quarter at low qualities. OpenCV where it is installed, else Pillow,
    which picamera2 brings; both let other threads run meanwhile.
    """
    try:
        smaller = _by_opencv(jpeg, quality)
    except ImportError:
        smaller = _by_pillow(jpeg, quality)
    return smaller if smaller is not None and len(smaller) < len(jpeg) else jpeg


def _by_opencv(jpeg: bytes, quality: int) -> bytes | None:
    import cv2
    import numpy as np

    image = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_UNCHANGED) if jpeg else None
    if image is None:
        return None
    settings = [cv2.IMWRITE_JPEG_QUALITY, quality, cv2.IMWRITE_JPEG_OPTIMIZE, 1]
    return bytes(cv2.imencode(".jpg", image, settings)[1])


def _by_pillow(jpeg: bytes, quality: int) -> bytes | None:
    try:
        from PIL import Image
    except ImportError:
        logger.debug("neither OpenCV nor Pillow is installed: pictures stay as the camera made them")
        return None
    smaller = io.BytesIO()
    try:
        with Image.open(io.BytesIO(jpeg)) as image:
            image.save(smaller, "JPEG", quality=quality, optimize=True)
    except OSError:
        return None
    return smaller.getvalue()
