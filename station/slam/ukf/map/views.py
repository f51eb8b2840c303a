"""Views for the map: keyframes that differ from each other, with SIFT features matched to the views before.

The filter's corners are followed from frame to frame; nobody finds them again from elsewhere. These features are found
again: when the robot comes back, and when it looks for its place in the map another day (docs/slam.md, sec. 10).
"""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from shared.geometry import FloatArray, rotation_angle
from station.motion.preintegration import Preintegration, chain
from station.slam.mapping.config import MappingConfig
from station.slam.mapping.tracks import Pairs
from station.slam.ukf.map.keyframes import Keyframe
from station.vision.features import DetailExtractor, Features, similarities
from station.vision.lens import Lens
from station.vision.matching import match_both_ways


@dataclass(frozen=True, slots=True)
class ViewConfig:
    min_flow: float = 0.1  # median motion of common features since the last view, as a fraction of the image width
    min_common: float = 0.6  # or fewer than that share of the last view's features are left
    max_interval_s: float = 2.0
    min_interval_s: float = 0.2  # a machine that is too slow must not make a view of each picture it still gets to
    min_interval_turned_s: float = 0.1  # of a head that has turned as far by then: with its body it is twice as fast
    num_previous: int = 4  # views before, that each one is matched with
    capacity: int = 1000  # 0.3 MB each; beyond, every second view goes and the spacing grows by half


@dataclass(frozen=True, slots=True, eq=False)
class View:
    frame_index: int  # ImageFrame.index
    segment: int
    keyframe: Keyframe  # its IMU link is since the view before
    features: Features
    seen: Features  # what localisation sees in it


class MapViews:
    """Grows while the robot drives; bounded.

    Choosing a view is cheap and done at once, describing it costs as much as following ten frames: it waits until
    somebody has time for it (`describe_next`), and gives the same whenever that is.
    """

    def __init__(self, lens: Lens, config: ViewConfig, seed: int, up_deg: float | None = None) -> None:
        """`up_deg`: which way is up in the pictures (`Calibration.up_in_image_deg`)."""
        self._lens, self._config = lens, config
        self.mapping = MappingConfig(seed=seed)
        self._extractor = DetailExtractor(up_deg)
        self._spacing = 1.0
        self._chosen: deque[Keyframe] = deque()  # that wait to be described
        self._newest: Keyframe | None = None
        self._link: Preintegration | None = None  # IMU since the newest view, once
        self._is_linked = False  # a keyframe has come after it
        self._items: list[View] = []
        self._pairs: list[Pairs] = []  # indices into items, unverified
        self.carried_on: set[int] = set()  # segments that began where wheels and gyroscope had carried the robot

    @property
    def least_turn_rad(self) -> float:
        """A camera that only turned by less shows no other view."""
        camera = self._lens.camera
        return self._spacing * self._config.min_flow * camera.width / camera.fx

    def add(self, keyframe: Keyframe) -> None:
        """Take a keyframe in; it becomes a view when it shows something else than the last one."""
        self._link = joined(self._link, keyframe.link) if self._is_linked else keyframe.link
        self._is_linked = True
        if not self._is_new(keyframe):
            return
        self._newest = keyframe
        self._chosen.append(replace(keyframe, link=self._link))
        self._is_linked = False
        if len(self._items) + len(self._chosen) > self._config.capacity:
            self.describe_all()
            self._thin()

    @property
    def spacing(self) -> float:
        """By how much more than at first they are apart: grows where some are left out."""
        return self._spacing

    def begin_anew(self, keyframes: Sequence[Keyframe]) -> None:
        """Forget the views so far and choose among these keyframes."""
        self._spacing = 1.0
        self._chosen.clear()
        self._newest, self._link, self._is_linked = None, None, False
        self._items, self._pairs = [], []
        for keyframe in keyframes:
            self.add(keyframe)

    def piece(self, segment: int) -> int:
        """The first one of the segments that are mapped together with this one."""
        while segment in self.carried_on:
            segment -= 1
        return segment

    def describe_next(self) -> bool:
        """Describe one view that waits; False when none does."""
        if not self._chosen:
            return False
        keyframe = self._chosen.popleft()
        found = self._extractor.extract(keyframe.image.grey())
        b = len(self._items)
        self._items.append(View(keyframe.image.index, keyframe.segment, keyframe, found.features, found.seen))
        for a in range(max(0, b - self._config.num_previous), b):
            if self.piece(self._items[a].segment) == self.piece(keyframe.segment):
                similarity = similarities(self._items[a].features, found.features)
                self._pairs.append((a, b, match_both_ways(similarity, self.mapping.matching.max_ratio)))
        return True

    def chosen_after(self, frame_index: int) -> list[int]:
        """Frame indices of the views after a frame, described or not."""
        frames = [v.frame_index for v in self._items] + [k.image.index for k in self._chosen]
        return frames[bisect_right(frames, frame_index) :]

    def describe_until(self, frame_index: int) -> None:
        """Describe the views up to one."""
        while self._chosen and self._chosen[0].image.index <= frame_index:
            self.describe_next()

    def described(self) -> list[View]:
        """The views described so far."""
        return self._items

    def matches_among(self, frame_index: Sequence[int]) -> list[Pairs]:
        """Unverified matches between some of the views described; numbered as given."""
        number = {frame: k for k, frame in enumerate(frame_index)}
        at = [number.get(v.frame_index, -1) for v in self._items]
        return [(at[a], at[b], pairs) for a, b, pairs in self._pairs if at[a] >= 0 and at[b] >= 0]

    def describe_all(self) -> tuple[list[View], list[Pairs]]:
        """All views, and the unverified matches between them."""
        while self.describe_next():
            pass
        return self._items, self._pairs

    def follow(self, pose_of: Callable[[int], FloatArray | None], segment: int) -> None:
        """Give the views of a segment the poses (4, 4) that their frames have now, by frame index."""
        self.describe_all()
        for i, view in enumerate(self._items):
            T = pose_of(view.frame_index) if view.segment == segment else None
            if T is None:
                continue
            if view.keyframe.T_body_head is not None:
                T = T @ view.keyframe.T_body_head
            self._items[i] = replace(view, keyframe=replace(view.keyframe, T_world_head=T))

    def pictures(self) -> list[bytes]:
        """Of the views described so far, as they were encoded."""
        return [view.keyframe.image.encoded for view in self._items]

    def seen(self, number: int) -> Features:
        """What pictures()[number] shows."""
        return self._items[number].seen

    def _is_new(self, keyframe: Keyframe) -> bool:
        if self._newest is None or self._newest.segment != keyframe.segment:
            return True
        last, config = self._newest, self._config
        since_s = (keyframe.image.t_robot_ns - last.image.t_robot_ns) * 1e-9
        if since_s < config.min_interval_s:
            return self._has_turned_away(last, keyframe, since_s)
        _, i, j = np.intersect1d(last.tracked.ids, keyframe.tracked.ids, assume_unique=True, return_indices=True)
        if len(i) == 0 or len(i) < config.min_common / self._spacing * len(last.tracked.ids):
            return True
        flow = float(np.median(np.linalg.norm(last.tracked.uv_px[i] - keyframe.tracked.uv_px[j], axis=1)))
        waited = since_s > config.max_interval_s * self._spacing
        enough = self._spacing * config.min_flow * self._lens.camera.width
        return flow > enough or (waited and flow > 0.2 * enough)

    def _has_turned_away(self, last: Keyframe, keyframe: Keyframe, since_s: float) -> bool:
        """Whether a head that turns shows something else so soon: of views farther apart few landmarks are in three."""
        if keyframe.T_body_head is None or since_s < self._config.min_interval_turned_s:
            return False
        R = last.T_world_head[:3, :3].T @ keyframe.T_world_head[:3, :3]
        return bool(rotation_angle(R) > self.least_turn_rad)

    def _thin(self) -> None:
        """Every second view stays, with the matches among those that stay."""
        for gone, after in zip(range(1, len(self._items) - 1, 2), range(2, len(self._items), 2), strict=True):
            before, kept = self._items[gone].keyframe, self._items[after].keyframe
            self._items[after] = replace(
                self._items[after], keyframe=replace(kept, link=joined(before.link, kept.link))
            )
        if len(self._items) % 2 == 0:  # the newest goes
            self._link, self._is_linked = self._items[-1].keyframe.link, True
        self._items = self._items[::2]
        self._pairs = [(a // 2, b // 2, pairs) for a, b, pairs in self._pairs if a % 2 == 0 and b % 2 == 0]
        self._newest = self._items[-1].keyframe
        self._spacing *= 1.5


def joined(before: Preintegration | None, after: Preintegration | None) -> Preintegration | None:
    """The IMU over two intervals, where it is known over both."""
    return None if before is None or after is None else chain(before, after)
