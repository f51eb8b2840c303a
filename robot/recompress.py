"""A JPEG again with another quality, in a thread of its own. The only file that knows what does it."""

from __future__ import annotations

import asyncio
import io
import logging
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor

from robot.video import Picture

logger = logging.getLogger(__name__)


class Recompressor:
    """Makes pictures smaller in the background. Methods belong on the event loop."""

    def __init__(self, on_made: Callable[[], None]) -> None:
        self._on_made = on_made
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="recompress")

    def begin(self, picture: Picture, quality: int) -> None:
        """Make `picture.smaller[quality]`."""
        loop = asyncio.get_running_loop()

        def keep(smaller: bytes) -> None:
            picture.smaller[quality] = smaller
            self._on_made()

        def hand_over(made: Future[bytes]) -> None:
            if not made.cancelled() and not loop.is_closed():
                loop.call_soon_threadsafe(keep, made.result())

        self._thread.submit(recompress, picture.frame.jpeg, quality).add_done_callback(hand_over)

    def close(self) -> None:
        self._thread.shutdown(wait=False, cancel_futures=True)


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
