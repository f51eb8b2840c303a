"""One frame of MonoSLAM, in `MonoFilter.process`. Pure: what looks into the image is handed in (`Finder`)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from shared.geometry import FloatArray, IntArray
from station.slam.mono.config import MonoConfig
from station.slam.mono.state import Expected, State
from station.slam.mono.window import Measured, Window
from station.vision.innovations import agreeing
from station.vision.lens import BoolArray, Lens

MARGIN_PX = 10.0  # to the image's border: a patch must fit


class Finder(Protocol):
    """What looks into one image."""

    def find(self, state: State, expected: Expected) -> tuple[FloatArray, BoolArray]:
        """Where the expected features are (M, 2), and which of them were found (M,)."""
        ...

    def new_features(self, state: State, ids: IntArray) -> tuple[FloatArray, FloatArray]:
        """Pixels (K, 2) and State.noise (K, 2, 2) of what to follow from now on, by the first K of these ids."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class FrameResult:
    """What one frame gave."""

    predicted: State  # before the update
    expected: Expected  # features that were chosen to be looked for
    num_found: int  # of them, in agreement
    ids: IntArray  # (K,) of these, then of the new ones
    uv_px: FloatArray  # (K, 2) as measured
    again: list[State]  # where a window is gone through again: the states after each of its images, now better


class MonoFilter:
    def __init__(self, lens: Lens, config: MonoConfig, first_id: int = 0) -> None:
        self._lens, self._config = lens, config
        self.state = State.first(config)
        self.sigma_px = config.sigma_px
        self.next_id = first_id
        self._first, self._images = self.state, list[Measured]()  # of the window: the state before it, its images

    def process(self, dt_s: float, finder: Finder) -> FrameResult:
        """Take one image in, dt_s after the one before."""
        predicted, _ = self.state.moved(self._config, dt_s)  # eqs. 2.1 to 2.3
        expected = self._choose(predicted)  # eqs. 2.4 to 2.6, C.5
        uv, is_found = finder.find(predicted, expected)
        found = np.flatnonzero(is_found)
        agreed = found[agreeing(uv[found] - expected.uv_px[found], expected.of(found).S, self._config.agree_chi2)]
        self.state = predicted.updated(expected.of(agreed), uv[agreed])
        new_ids, new_uv = self._add(finder)  # eq. C.2
        ids = np.concatenate([predicted.ids[expected.rows[agreed]], new_ids])
        uv = np.concatenate([uv[agreed], new_uv])
        again = self._go_again(Measured(dt_s, ids, uv, predicted.ids[expected.rows]))
        return FrameResult(predicted, expected, len(agreed), ids, uv, again)

    def _choose(self, state: State) -> Expected:
        """The features in view, the most informative (S is largest beside their noise) where there are too many."""
        in_view, _ = state.in_view(self._lens, MARGIN_PX)
        expected = state.expect(self._lens, in_view, self.sigma_px)
        gain = np.linalg.det(expected.ellipses()) / np.linalg.det(state.noise[expected.rows])
        return expected.of(np.sort(np.argsort(-gain, kind="stable")[: self._config.num_measured]))

    def _go_again(self, image: Measured) -> list[State]:
        """Keep the image; now and then, and where the window ends, go through all of its images once more."""
        config = self._config
        self._images = [kept.only(self.state.ids) for kept in [*self._images, image]]
        count = len(self._images)
        if count not in config.window_images:
            return []
        again, self.sigma_px = Window(self._lens, config, self._first, self._images).again(self.state, self.sigma_px)
        self.state = again[-1]
        if count == config.window_images[-1]:
            self._tend()
            self._first, self._images = self.state, []
        return again

    # ---- the map

    def _tend(self) -> None:
        """Convert what is linear (eq. C.3); give up what is found too rarely, beyond infinity, or too much."""
        config = self._config
        state = self.state.with_xyz(self.state.linearity() < config.max_linearity)
        wanted = np.sum([np.isin(state.ids, image.wanted) for image in self._images], axis=0)
        found = np.sum([np.isin(state.ids, image.ids) for image in self._images], axis=0)
        row = state.rows()[:, 5]
        leave = state.is_inverse & (state.x[row] + 2.0 * np.sqrt(np.maximum(state.P[row, row], 0.0)) < 0.0)
        leave |= (wanted >= config.min_tries) & (found < config.min_found_share * wanted)
        unseen = np.flatnonzero(~leave & (found == 0))  # the oldest first
        leave[unseen[: max(int((~leave).sum()) + config.num_measured - config.max_features, 0)]] = True
        self.state = state.only(state.ids[~leave])

    def _add(self, finder: Finder) -> tuple[IntArray, FloatArray]:
        """New features where the picture has too few: their ids and pixels."""
        state, config = self.state, self._config
        ids = self.next_id + np.arange(max(config.max_features - len(state.ids), 0))
        uv, noise = finder.new_features(state, ids)
        ids, self.next_id = ids[: len(uv)], self.next_id + len(uv)
        self.state = state.with_features(ids, uv, noise, self._lens, config, self.sigma_px)
        return ids, uv
