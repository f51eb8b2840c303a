"""One frame of MonoSLAM: predict, look where the features should be, agree on what was found, update, tend the map.

`process` is the algorithm. Pure: what looks into the image is handed in (`Finder`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from shared.geometry import FloatArray, IntArray
from station.slam.mono.config import FilterConfig
from station.slam.mono.measurement import Predicted, predict
from station.slam.mono.motion import first_camera
from station.slam.mono.start import Start
from station.slam.mono.state import State
from station.vision.lens import BoolArray, Lens

MARGIN_PX = 10.0  # to the image's border: a patch must fit


@dataclass(frozen=True, slots=True, eq=False)
class Wanted:
    """Features to look for, each inside its ellipse (eq. 2.6)."""

    state: State
    rows: IntArray  # (M,) of state.ids
    uv_px: FloatArray  # (M, 2) where they should be
    S: FloatArray  # (M, 2, 2) how surely
    gate_sigmas: float  # size of the ellipse


class Finder(Protocol):
    """What looks into one image."""

    def find(self, wanted: Wanted) -> tuple[FloatArray, BoolArray, BoolArray]:
        """Where the wanted features are (M, 2), which were looked for (M,) and which of these were found (M,)."""
        ...

    def new_features(self, existing_px: FloatArray, count: int) -> FloatArray:
        """At most `count` pixels (K, 2) that are worth following, away from those that are followed."""
        ...

    def remember(self, ids: IntArray, uv_px: FloatArray, state: State) -> None:
        """Keep what is to be found again of new features."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class FrameResult:
    """What one frame gave."""

    ids: IntArray  # (K,) of the features that took part, then of the new ones
    uv_px: FloatArray  # (K, 2) as measured
    num_found: int  # of ids: how many took part
    num_tried: int
    wanted: Wanted
    settled: IntArray  # ids of the features that became XYZ
    removed: State | None  # features that left the map, as part of the state before
    gone: IntArray  # ids of all that left


class MonoFilter:
    def __init__(self, lens: Lens, config: FilterConfig, first_id: int = 0) -> None:
        self._lens = lens
        self._config = config
        nothing = np.zeros(0, dtype=np.int64)
        self.state = State(*first_camera(config), nothing, nothing.astype(bool))
        self.sigma_px = config.sigma_px
        self._tries: dict[int, IntArray] = {}  # by id: times looked for, times found, last frame found
        self._frame = 0
        self._bias: dict[int, tuple[int, FloatArray]] = {}
        self.next_id = first_id
        self._start = Start(lens, config)

    def process(self, dt_s: float, finder: Finder) -> FrameResult:
        """Take one image in, dt_s after the one before."""
        config, self._frame, before = self._config, self._frame + 1, self.state.ids
        state = self.state.moved(config, dt_s)  # eqs. 2.1 to 2.3
        wanted, seen = self._choose(state)  # eqs. 2.4 to 2.6, C.5
        uv, tried, found = finder.find(wanted)
        agreed = np.flatnonzero(found)
        if len(agreed):
            state, agreed = self._update(state, wanted, seen, uv, agreed)
            self._accumulate(state, wanted.rows[agreed], uv[agreed])
        self._count(state.ids[wanted.rows], tried, agreed)
        ids = state.ids[wanted.rows[agreed]]
        linear = np.flatnonzero(state.linearity() < config.max_linearity)
        settled, state = state.ids[linear], state.with_xyz(linear)
        self.state, removed = self._prune(state)
        new_ids, new_uv = self._add(finder)
        ids, uv = np.concatenate([ids, new_ids]), np.concatenate([uv[agreed], new_uv])
        self.state, self.sigma_px = self._start.take(dt_s, self.state, ids, uv, self.sigma_px)
        gone = np.setdiff1d(np.concatenate([before, new_ids]), self.state.ids)
        for number in gone.tolist():
            self._tries.pop(number, None)
            self._bias.pop(number, None)
        return FrameResult(ids, uv, len(agreed), int(tried.sum()), wanted, settled, removed, gone)

    def _choose(self, state: State) -> tuple[Wanted, Predicted]:
        """The features in view, the most informative (largest S) where there are too many."""
        seen = predict(state.camera, state.features(), state.is_inverse, self._lens, MARGIN_PX)
        rows = np.flatnonzero(seen.in_view)
        seen = state.with_product_moments(seen.of(rows), rows)
        S = state.innovation_ellipses(seen, rows, self.sigma_px)  # eq. 2.6
        if len(rows) > self._config.num_measured:
            best = np.sort(np.argsort(-np.linalg.det(S), kind="stable")[: self._config.num_measured])
            rows, S, seen = rows[best], S[best], seen.of(best)
        return Wanted(state, rows, seen.uv_px, S, self._config.gate_sigmas), seen

    def _update(
        self, state: State, wanted: Wanted, seen: Predicted, uv: FloatArray, found: IntArray
    ) -> tuple[State, IntArray]:
        """Two updates: with what agrees on one motion, then with what is right but was uncertain.

        Returns the state and which of the found features took part.
        Source: Civera et al., 1-Point RANSAC for EKF filtering, J. Field Robotics 27(5), 2010, algorithm 1.
        """
        config = self._config
        rows, uv = wanted.rows[found], uv[found]
        agree = self._consensus(state, rows, seen.of(found), uv)
        state = self._fuse(state, rows[agree], uv[agree])
        others = np.flatnonzero(~agree)
        if len(others):
            again = self._predict(state, rows[others])
            nu = uv[others] - again.uv_px
            ellipses = state.innovation_ellipses(again, rows[others], self.sigma_px)
            chi2 = np.einsum("mi,mij,mj->m", nu, np.linalg.inv(ellipses), nu)
            rescued = others[(chi2 < config.rescue_chi2) & again.in_view]
            state = self._fuse(state, rows[rescued], uv[rescued])
            agree[rescued] = True
        return state, found[agree]

    def _fuse(self, state: State, rows: IntArray, uv: FloatArray) -> State:
        """The Kalman update with the measured pixels (M, 2) of features."""
        if not len(rows):
            return state
        seen = self._predict(state, rows)
        HP = state.spread(seen, rows)
        S = state.innovation_covariance(seen, rows, HP, self.sigma_px)
        return state.updated(HP, S, (uv - seen.uv_px).ravel())

    def _predict(self, state: State, rows: IntArray) -> Predicted:
        every = predict(state.camera, state.features(), state.is_inverse, self._lens)
        return state.with_product_moments(every.of(rows), rows)

    def _consensus(self, state: State, rows: IntArray, seen: Predicted, uv: FloatArray) -> BoolArray:
        """Which measurements (M,) agree with the motion that the best single one of them says.

        The prior knows the motion so well that one feature settles the rest. There are so few that each is tried.
        """
        M = len(rows)
        HP = state.spread(seen, rows)
        S = state.innovation_covariance(seen, rows, HP, self.sigma_px).reshape(M, 2, M, 2).swapaxes(1, 2)
        nu = uv - seen.uv_px
        own = S[range(M), range(M)]
        gain = S @ np.linalg.inv(own)[None]  # [j, i]: what feature i's innovation says of feature j's
        left = nu[:, None] - (gain @ nu[None, :, :, None])[..., 0]
        spread = own[:, None] - gain @ S.swapaxes(0, 1)
        spread[range(M), range(M)] = self.sigma_px**2 * np.eye(2)
        chi2 = np.einsum("jia,jiab,jib->ji", left, np.linalg.inv(spread), left)
        agree: BoolArray = chi2 < self._config.rescue_chi2
        best: BoolArray = agree[:, int(np.argmax(agree.sum(axis=0)))]
        return best

    def _count(self, ids: IntArray, tried: BoolArray, agreed: IntArray) -> None:
        found = np.zeros(len(ids), dtype=bool)
        found[agreed] = True
        for number, was_tried, was_found in zip(ids.tolist(), tried.tolist(), found.tolist(), strict=True):
            tally = self._tries[number]
            tally[0] += was_tried
            tally[1] += was_found
            if was_found:
                tally[2] = self._frame

    def _accumulate(self, state: State, rows: IntArray, uv: FloatArray) -> None:
        """The mean error of each feature over its last pictures, after the update."""
        left = (uv - self._predict(state, rows).uv_px) / self.sigma_px
        for number, e in zip(state.ids[rows].tolist(), left, strict=True):
            count, bias = self._bias.get(number, (0, np.zeros(2)))
            count = min(count + 1, self._config.bias_frames)
            self._bias[number] = count, bias + (e - bias) / count

    def _is_biased(self, number: int) -> bool:
        count, bias = self._bias.get(number, (0, np.zeros(2)))
        return count >= self._config.bias_frames and float(np.linalg.norm(bias)) > self._config.max_bias_sigmas

    def _prune(self, state: State) -> tuple[State, State | None]:
        """Give up what is found too rarely or lies beyond infinity, and of too many what was not seen for longest."""
        config = self._config
        if not len(state.ids):
            return state, None
        tally = np.array([self._tries[number] for number in state.ids.tolist()])
        rare = (tally[:, 0] >= config.min_tries) & (tally[:, 1] < config.min_found_share * tally[:, 0])
        row = state.rows()[:, 5]
        beyond = state.is_inverse & (state.x[row] + 2.0 * np.sqrt(np.maximum(state.P[row, row], 0.0)) < 0.0)
        leave = rare | beyond
        leave |= np.array([self._is_biased(number) for number in state.ids.tolist()])
        surplus = int((~leave).sum()) + config.num_measured - config.max_features
        if surplus > 0:
            oldest = np.argsort(np.where(leave, self._frame, tally[:, 2]), kind="stable")[:surplus]
            leave[oldest[tally[oldest, 2] < self._frame]] = True
        if not leave.any():
            return state, None
        for number in state.ids[leave].tolist():
            del self._tries[number]
        return state.without(leave), state.without(~leave)

    def _add(self, finder: Finder) -> tuple[IntArray, FloatArray]:
        """New features where the picture has too few: their ids and pixels."""
        state, config = self.state, self._config
        seen = predict(state.camera, state.features(), state.is_inverse, self._lens)
        existing = seen.uv_px[seen.in_view]
        count = min(config.num_measured - len(existing), config.max_features - len(state.ids))
        uv = finder.new_features(existing, count) if count > 0 else np.zeros((0, 2))
        ids = np.arange(self.next_id, self.next_id + len(uv))
        if len(ids):
            self.next_id += len(ids)
            self._tries |= {number: np.array([0, 0, self._frame]) for number in ids.tolist()}
            self.state = state.with_features(ids, uv, self._lens, config, self.sigma_px)
            finder.remember(ids, uv, self.state)
        return ids, uv
