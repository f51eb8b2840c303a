"""Keyframes: poses that left the filter's window, with what was seen from them and the IMU link to the one before."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from shared.geometry import FloatArray
from station.model.frames import ImageArray, ImageFrame
from station.motion.head import HeadThen
from station.motion.preintegration import Preintegration, chain
from station.slam.ukf.filter.constraints import BodyVelocity
from station.vision.klt import TrackedFrame


@dataclass(frozen=True, slots=True, eq=False)
class Keyframe:
    """One view that landmarks are observed from."""

    image: ImageFrame
    tracked: TrackedFrame
    rgb: npt.NDArray[np.uint8]  # (N, 3) colour at each of tracked's features
    T_world_head: FloatArray  # (4, 4) of what carries the camera, as the filter knew it last
    v_world: FloatArray  # (3,)
    omega_head: FloatArray  # (3,)
    bias: FloatArray  # (6,)
    segment: int
    link: Preintegration | None  # IMU since the previous keyframe of the segment
    wheels: BodyVelocity | None  # where wheels know it
    # (4, 4) as the filter knew it last; None: the head was never turned, and is where the body is
    T_body_head: FloatArray | None = None
    head: HeadThen | None = None  # the same, for whoever knows its servos better


class KeyframeStore:
    """All keyframes of a navigation, at most `capacity`: beyond it, the one that adds least goes."""

    def __init__(self, capacity: int) -> None:
        self._capacity = capacity
        self.items: list[Keyframe] = []

    def add(self, keyframe: Keyframe) -> None:
        self.items.append(keyframe)
        if len(self.items) > self._capacity:
            self._thin()

    def segment(self, number: int) -> list[Keyframe]:
        return [k for k in self.items if k.segment == number]

    def _thin(self) -> None:
        """Remove the older keyframe whose neighbours are nearest to each other; their IMU links join."""
        x = np.array([k.T_world_head[:3, 3] for k in self.items])
        axis = np.array([k.T_world_head[:3, 0] for k in self.items])
        segment = np.array([k.segment for k in self.items])
        gap = np.linalg.norm(x[2:] - x[:-2], axis=1) + np.linalg.norm(axis[2:] - axis[:-2], axis=1)
        inner = (segment[2:] == segment[:-2]) & (np.arange(len(gap)) < len(gap) - 30)
        if not inner.any():
            del self.items[0]
            return
        index = int(np.argmin(np.where(inner, gap, np.inf))) + 1
        gone, after = self.items[index], self.items[index + 1]
        link = chain(gone.link, after.link) if gone.link is not None and after.link is not None else None
        self.items[index + 1] = replace(after, link=link)
        del self.items[index]


def is_grey(encoded: bytes) -> bool:
    """Whether a PNG or JPEG file has one channel, from its header: such images need no second, colour decoding."""
    if encoded[:8] == b"\x89PNG\r\n\x1a\n":
        return len(encoded) > 25 and encoded[25] in (0, 4)
    at = 2
    while at + 9 < len(encoded) and encoded[at] == 0xFF:  # JPEG: walk the segments to the frame header
        marker = encoded[at + 1]
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            return encoded[at + 9] == 1
        at += 2 + int.from_bytes(encoded[at + 2 : at + 4], "big")
    return False


def sample_grey(grey: ImageArray, uv_px: FloatArray) -> npt.NDArray[np.uint8]:
    """Grey values as RGB (N, 3) at pixels (N, 2)."""
    return sample_colours(np.repeat(grey[:, :, None], 1, axis=2), uv_px).repeat(3, axis=1)


def sample_colours(bgr: ImageArray, uv_px: FloatArray) -> npt.NDArray[np.uint8]:
    """Colours RGB (N, 3) of an image at pixels (N, 2)."""
    u = np.clip(np.rint(uv_px[:, 0]).astype(int), 0, bgr.shape[1] - 1)
    v = np.clip(np.rint(uv_px[:, 1]).astype(int), 0, bgr.shape[0] - 1)
    return np.asarray(bgr[v, u, ::-1], dtype=np.uint8)
