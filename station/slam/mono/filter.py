"""One frame of MonoSLAM: predict, look where the features should be, agree on what was found, update, tend the map.

`process` is the algorithm. Pure: what looks into the image is handed in (`Finder`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from shared.geometry import FloatArray, IntArray
from station.slam.mono.config import FilterConfig
from station.slam.mono.state import Expected, State
from station.slam.mono.window import Measured, Window
from station.vision.lens import BoolArray, Lens

MARGIN_PX = 10.0  # to the image's border: a patch must fit


class Finder(Protocol):
    """What looks into one image."""

    def find(self, state: State, expected: Expected) -> tuple[FloatArray, BoolArray, BoolArray]:
        """Where the expected features are (M, 2), which were looked for (M,) and which of these were found (M,)."""
        ...

    def new_features(self, px: FloatArray, noise: FloatArray, count: int) -> tuple[FloatArray, FloatArray]:
        """Pixels (K, 2) that are worth following, and State.noise of each (K,).

        px, noise: (N, 2), (N,) of those that are followed already.
        count: of all features as sharp or sharper.
        """
        ...

    def remember(self, ids: IntArray, uv_px: FloatArray, state: State) -> None:
        """Keep what is to be found again of new features: those there was room for, the first ones."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class FrameResult:
    """What one frame gave."""

    ids: IntArray  # (K,) of the features that took part, then of the new ones
    uv_px: FloatArray  # (K, 2) as measured
    num_found: int  # of ids: how many took part
    num_tried: int
    predicted: State  # before the update
    expected: Expected  # features that were chosen to be looked for
    settled: IntArray  # ids of the features that became XYZ
    again: list[State]  # where a window ends: the states after each of its images, better than they were


class MonoFilter:
    def __init__(self, lens: Lens, config: FilterConfig, first_id: int = 0) -> None:
        self._lens, self._config = lens, config
        self.state = State.first(config)
        self.sigma_px = config.sigma_px
        self.next_id = first_id
        self._first, self._images = self.state, list[Measured]()  # of the window: the state before it, its images
        self.is_starting = True  # until the first images have been gone through again, after which all is known better

    def process(self, dt_s: float, finder: Finder) -> FrameResult:
        """Take one image in, dt_s after the one before."""
        predicted = self.state.moved(self._config, dt_s)  # eqs. 2.1 to 2.3
        expected = self._choose(predicted)  # eqs. 2.4 to 2.6, C.5
        uv, tried, found = finder.find(predicted, expected)
        agreed = self._compatible(expected, uv, np.flatnonzero(found))
        self.state = predicted.updated(expected.of(agreed), uv[agreed])
        new_ids, new_uv = self._add(finder)
        ids = np.concatenate([predicted.ids[expected.rows[agreed]], new_ids])
        uv = np.concatenate([uv[agreed], new_uv])
        image = Measured(dt_s, ids, uv, predicted.ids[expected.rows])
        again, settled = self._go_again(image)
        return FrameResult(ids, uv, len(agreed), int(tried.sum()), predicted, expected, settled, again)

    def _choose(self, state: State) -> Expected:
        """The features in view, the most informative (S is largest beside their noise) where there are too many."""
        seen = state.predict(self._lens)
        in_view = seen.is_ahead & self._lens.is_inside(seen.uv_px, MARGIN_PX)
        expected = state.expect(self._lens, np.flatnonzero(in_view), self.sigma_px)
        gain = np.linalg.det(expected.ellipses()) / state.noise[expected.rows] ** 4
        return expected.of(np.sort(np.argsort(-gain, kind="stable")[: self._config.num_measured]))

    def _compatible(self, expected: Expected, uv: FloatArray, found: IntArray) -> IntArray:
        """Which of the found measurements (K,) agree with each other; uv (M, 2) are measured pixels.

        All innovations nu are one Gaussian with covariance S, in which S^-1 says what each of them should be where the
        others are known: off by (S^-1)_ii^-1 (S^-1 nu)_i, with covariance (S^-1)_ii^-1. While one contradicts, the one
        that does so most goes.
        Source: Neira and Tardos, Data association in stochastic mapping using the joint compatibility test, IEEE T-RA
        17(6), 2001; patches have one candidate each, so that no tree has to be searched.
        """
        while len(found):
            chosen = expected.of(found)
            information = np.asarray(np.linalg.inv(chosen.S), dtype=np.float64)
            left = (information @ (uv[found] - chosen.uv_px).ravel()).reshape(-1, 2)
            own = replace(chosen, S=information).ellipses()
            chi2 = np.einsum("mi,mij,mj->m", left, np.linalg.inv(own), left)
            worst = int(np.argmax(chi2))
            if chi2[worst] < self._config.agree_chi2:
                break
            found = np.delete(found, worst)
        return found

    def _go_again(self, image: Measured) -> tuple[list[State], IntArray]:
        """Keep the image; at the end of a window, and within the first one, go through all of its images once more.

        Returns the better states after each of them, and which features became XYZ.
        """
        config, is_start = self._config, self.is_starting
        self._images = [kept.only(self.state.ids) for kept in [*self._images, image]]
        ends = config.start_images if is_start else (config.window_images,)
        if len(self._images) not in ends:
            return [], image.ids[:0]
        window = Window(self._lens, config, self._first, self._images)
        again, self.sigma_px = window.again(self.state, self.sigma_px, is_start)
        self.state = again[-1]
        if len(self._images) < ends[-1]:
            return again, image.ids[:0]
        settled = self._tend()
        self._first, self._images, self.is_starting = self.state, [], False
        return again, settled

    # ---- the map

    def _tend(self) -> IntArray:
        """Convert what is linear; give up what is found too rarely, beyond infinity, or too much. Ids converted."""
        config, state = self._config, self.state
        is_linear = state.linearity() < config.max_linearity
        settled, state = state.ids[is_linear], state.with_xyz(is_linear)
        row = state.rows()[:, 5]
        wanted = np.sum([np.isin(state.ids, image.wanted) for image in self._images], axis=0)
        found = np.sum([np.isin(state.ids, image.ids) for image in self._images], axis=0)
        leave = state.is_inverse & (state.x[row] + 2.0 * np.sqrt(np.maximum(state.P[row, row], 0.0)) < 0.0)
        leave |= (wanted >= config.min_tries) & (found < config.min_found_share * wanted)
        unseen = np.flatnonzero(~leave & (found == 0))  # the oldest first
        leave[unseen[: max(int((~leave).sum()) + config.num_measured - config.max_features, 0)]] = True
        self.state = state.without(leave)
        return settled

    def _add(self, finder: Finder) -> tuple[IntArray, FloatArray]:
        """New features where the picture has too few: their ids and pixels."""
        state, config = self.state, self._config
        seen = state.predict(self._lens)
        in_view = seen.is_ahead & self._lens.is_inside(seen.uv_px)
        uv, noise = finder.new_features(seen.uv_px[in_view], state.noise[in_view], config.num_measured)
        room = max(config.max_features - len(state.ids), 0)
        uv, noise = uv[:room], noise[:room]
        ids = np.arange(self.next_id, self.next_id + len(uv))
        self.next_id += len(ids)
        self.state = state.with_features(ids, uv, noise, self._lens, config, self.sigma_px)
        finder.remember(ids, uv, self.state)
        return ids, uv
