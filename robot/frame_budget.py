"""How large a picture may be, and how often one goes out, on a link of a given rate. Pure.

What is kept as long as possible, the most important last: 30 pictures a second, the camera's own quality, 20 even
pictures a second, features by which a place is known again, corners that SLAM can follow. The reasons:
docs/decisions/0017-jpeg-that-adapts.md.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from robot.link_meter import LinkEstimate

EVEN_RATE_HZ = 20.0  # SLAM follows corners from picture to picture and is best at 15; lost packets cost some
USED_SHARE = 0.9  # of what the link carries: what is used whole has a queue
LONGEST_SERVICE_S = 0.12  # a picture's time on the link, of the 250 ms that it may be old on arrival
LONGEST_INTERVAL_S = 0.5
SPARE = 1.25  # as much more must fit before the pictures come more often: a rate that swings is not even
# JPEG quality → bytes, relative to quality 80: medians of twelve pictures of the simulated home. At 20 a corner
# is found within 0.1 px (median) of where it is in the camera's own picture, at 10 within 0.2 px.
SIZE_AT = {80: 1.0, 65: 0.68, 50: 0.50, 40: 0.43, 30: 0.35, 25: 0.30, 20: 0.25, 15: 0.20, 10: 0.145}
LEAST_QUALITY = min(SIZE_AT)
# The even rate is not worth less than this: of the SIFT features of the camera's own picture half are found again at
# 20, a third at 10 (within 2 px, 40 pictures of a simulated drive); landmarks and answers to "where" become as few.
EVEN_QUALITY = 20


@dataclass(frozen=True, slots=True)
class FrameBudget:
    """What one picture may take."""

    num_bytes: float
    interval_ns: int  # from picture to picture; 0: every one that the camera makes


UNLIMITED = FrameBudget(math.inf, 0)
BEFORE_MEASURED = FrameBudget(20_000, 0)  # at 1 Mbit/s under way for 0.16 s


class SizeModel:
    """How many bytes a picture of the present scene has at which quality, learned from those made."""

    def __init__(self) -> None:
        self._share = 0.7  # of the camera's own bytes, at quality 80

    def learn(self, own_bytes: int, quality: int, num_bytes: int) -> None:
        self._share = 0.7 * self._share + 0.3 * num_bytes / own_bytes / SIZE_AT[quality]

    def size(self, own_bytes: int, quality: int) -> float:
        return own_bytes * self._share * SIZE_AT[quality]

    def quality(self, own_bytes: int, max_bytes: float) -> int | None:
        """The best that fits, or the least; None: the camera's own."""
        if own_bytes <= max_bytes:
            return None
        return next((q for q in SIZE_AT if self.size(own_bytes, q) <= max_bytes), LEAST_QUALITY)


def budget(
    estimate: LinkEstimate, own_bytes: int, sizes: SizeModel, period_ns: int, before: FrameBudget
) -> FrameBudget:
    """What pictures may take.

    Args:
        own_bytes: of a picture as the camera made it.
        sizes: of what is made of it.
        period_ns: from picture to picture of the camera.
        before: what they may take now.
    """
    # IMU and reports go first. Where they leave nothing, a little is taken for pictures all the same.
    rate = max(USED_SHARE * estimate.bytes_per_s - estimate.other_bytes_per_s, 0.1 * estimate.bytes_per_s)
    most_bytes = LONGEST_SERVICE_S * estimate.bytes_per_s
    even_bytes, least_bytes = (min(own_bytes, sizes.size(own_bytes, q)) for q in (EVEN_QUALITY, LEAST_QUALITY))

    def bytes_of(interval_ns: float) -> float:
        is_quicker = interval_ns < before.interval_ns - period_ns // 2  # the camera's beat itself swings
        return min(rate * interval_ns * 1e-9 / (SPARE if is_quicker else 1.0), most_bytes)

    even_ns = max(1, math.floor(1.05e9 / EVEN_RATE_HZ / period_ns)) * period_ns
    for interval_ns in range(period_ns, even_ns + 1, period_ns):
        if (even_bytes if interval_ns == even_ns else own_bytes) <= bytes_of(interval_ns):
            return FrameBudget(bytes_of(interval_ns), interval_ns if interval_ns > period_ns else 0)
    slow_ns = math.ceil(least_bytes / rate * 1e9 / period_ns) * period_ns
    slow_ns = min(max(slow_ns, even_ns + period_ns), round(LONGEST_INTERVAL_S * 1e9))
    return FrameBudget(max(least_bytes, bytes_of(slow_ns)), slow_ns)
