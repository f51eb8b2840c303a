"""One frame of MonoSLAM: predict, look where the features should be, agree on what was found, update, tend the map.

`process` is the algorithm. Pure: what looks into the image is handed in (`Finder`).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from shared.geometry import FloatArray, IntArray
from station.slam.mono.config import FilterConfig
from station.slam.mono.start import Measured, Start
from station.slam.mono.state import Expected, State
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
    start: list[State]  # where the start ends: the states after each of its images, better than they were


@dataclass(slots=True)
class Record:
    """How a feature has done."""

    last: int  # image in which it was found last
    tried: int = 0
    found: int = 0
    error: FloatArray = field(default_factory=lambda: np.zeros(2))  # mean of the last ones, sigmas


class MonoFilter:
    def __init__(self, lens: Lens, config: FilterConfig, first_id: int = 0) -> None:
        self._lens, self._config = lens, config
        self.state = State.first(config)
        self.sigma_px = config.sigma_px
        self.next_id = first_id
        self._records: dict[int, Record] = {}
        self._images: list[Measured] = []  # of the start
        self._frame = 0

    def process(self, dt_s: float, finder: Finder) -> FrameResult:
        """Take one image in, dt_s after the one before."""
        self._frame += 1
        state = self.state.moved(self._config, dt_s)  # eqs. 2.1 to 2.3
        expected = self._choose(state)  # eqs. 2.4 to 2.6, C.5
        M = range(len(expected.rows))
        S = expected.blocks()[M, M]
        wanted = Wanted(state, expected.rows, expected.uv_px, S, self._config.gate_sigmas)
        uv, tried, found = finder.find(wanted)
        state, agreed = self._update(state, expected, uv, np.flatnonzero(found))
        self._record(state, expected.rows, uv, tried, agreed)
        ids, uv = state.ids[expected.rows[agreed]], uv[agreed]
        self.state, settled, removed = state, ids[:0], None
        if self._frame > self._config.start_images[-1]:
            settled, removed = self._tend()
        new_ids, new_uv = self._add(finder)
        ids, uv = np.concatenate([ids, new_ids]), np.concatenate([uv, new_uv])
        start: list[State] = []
        if self._frame <= self._config.start_images[-1]:
            start = self._begin(Measured(dt_s, ids, uv))
        return FrameResult(ids, uv, len(agreed), int(tried.sum()), wanted, settled, removed, start)

    def _choose(self, state: State) -> Expected:
        """The features in view, the most informative (largest S) where there are too many."""
        seen = state.predict(self._lens)
        in_view = seen.is_ahead & self._lens.is_inside(seen.uv_px, MARGIN_PX)
        expected = state.expect(self._lens, np.flatnonzero(in_view), self.sigma_px)
        M = range(len(expected.rows))
        area = np.linalg.det(expected.blocks()[M, M])
        return expected.of(np.sort(np.argsort(-area, kind="stable")[: self._config.num_measured]))

    # ---- the update

    def _update(self, state: State, expected: Expected, uv: FloatArray, found: IntArray) -> tuple[State, IntArray]:
        """Two updates: with what agrees on one motion, then with what is right but was uncertain.

        uv (M, 2) are measured pixels, found (K,) says whose; returns the state and which of them took part.
        Source: Civera et al., 1-Point RANSAC for EKF filtering, J. Field Robotics 27(5), 2010, algorithm 1.
        """
        if not len(found):
            return state, found
        agree = self._consensus(expected.of(found), uv[found])
        agreed, others = found[agree], found[~agree]
        state = state.updated(expected.of(agreed), uv[agreed])
        if len(others):
            again = state.expect(self._lens, expected.rows[others], self.sigma_px)
            own = np.arange(len(others))
            nu = uv[others] - again.uv_px
            chi2 = np.einsum("mi,mij,mj->m", nu, np.linalg.inv(again.blocks()[own, own]), nu)
            rescued = np.flatnonzero(chi2 < self._config.rescue_chi2)
            state = state.updated(again.of(rescued), uv[others[rescued]])
            agreed = np.sort(np.append(agreed, others[rescued]))
        return state, agreed

    def _consensus(self, expected: Expected, uv: FloatArray) -> BoolArray:
        """Which measurements (M,) agree with the motion that the best single one of them says.

        The prior knows the motion so well that one feature settles the rest. There are so few that each is tried.
        """
        M = range(len(uv))
        S, nu = expected.blocks(), uv - expected.uv_px
        own = S[M, M]
        gain = S @ np.linalg.inv(own)  # [j, i]: what feature i's innovation says of feature j's
        left = nu[:, None] - (gain @ nu[:, :, None])[..., 0]
        spread = own[:, None] - gain @ S.swapaxes(0, 1)
        spread[M, M] = self.sigma_px**2 * np.eye(2)
        chi2 = np.einsum("jia,jiab,jib->ji", left, np.linalg.inv(spread), left)
        agree: BoolArray = chi2 < self._config.rescue_chi2
        best: BoolArray = agree[:, int(np.argmax(agree.sum(axis=0)))]
        return best

    def _begin(self, image: Measured) -> list[State]:
        """Keep the image; after some of the start's go through all of them once more."""
        self._images = [kept.only(self.state.ids) for kept in [*self._images, image]]
        if self._frame not in self._config.start_images:
            return []
        start, self.sigma_px = Start(self._lens, self._config, self._images).again(self.state, self.sigma_px)
        self.state = start[-1]
        return start

    # ---- the map

    def _record(self, state: State, rows: IntArray, uv: FloatArray, tried: BoolArray, agreed: IntArray) -> None:
        """Count what was found, with the errors that are left after the update."""
        error = (uv - state.predict(self._lens).uv_px[rows]) / self.sigma_px
        found = np.isin(np.arange(len(rows)), agreed)
        for number, was_tried, was_found, e in zip(state.ids[rows].tolist(), tried, found, error, strict=True):
            record = self._records[number]
            record.tried += int(was_tried)
            if was_found:
                record.last, record.found = self._frame, record.found + 1
                record.error = record.error + (e - record.error) / min(record.found, self._config.memory)

    def _is_bad(self, record: Record) -> bool:
        """Found too rarely, or with errors that do not average out."""
        config = self._config
        is_rare = record.tried >= config.min_tries and record.found < config.min_found_share * record.tried
        return is_rare or (
            record.found >= config.memory and float(np.linalg.norm(record.error)) > config.max_mean_sigmas
        )

    def _tend(self) -> tuple[IntArray, State | None]:
        """Convert what is linear, give up what is bad, beyond infinity, or too many; ids converted, and what left."""
        config, state = self._config, self.state
        is_linear = state.linearity() < config.max_linearity
        settled, state = state.ids[is_linear], state.with_xyz(is_linear)
        records = [self._records[number] for number in state.ids.tolist()]
        row = state.rows()[:, 5]
        beyond = state.is_inverse & (state.x[row] + 2.0 * np.sqrt(np.maximum(state.P[row, row], 0.0)) < 0.0)
        leave = beyond | np.array([self._is_bad(record) for record in records], dtype=bool)
        surplus = int((~leave).sum()) + config.num_measured - config.max_features
        last = np.array([record.last for record in records])
        oldest = np.argsort(np.where(leave, self._frame, last), kind="stable")[: max(surplus, 0)]
        leave[oldest[last[oldest] < self._frame]] = True
        self.state = state.without(leave)
        return settled, state.without(~leave) if leave.any() else None

    def _add(self, finder: Finder) -> tuple[IntArray, FloatArray]:
        """New features where the picture has too few: their ids and pixels."""
        state, config = self.state, self._config
        seen = state.predict(self._lens)
        existing = seen.uv_px[seen.is_ahead & self._lens.is_inside(seen.uv_px)]
        count = min(config.num_measured - len(existing), config.max_features - len(state.ids))
        uv = finder.new_features(existing, max(count, 0))
        ids = np.arange(self.next_id, self.next_id + len(uv))
        self.next_id += len(ids)
        self._records |= {number: Record(self._frame) for number in ids.tolist()}
        self.state = state.with_features(ids, uv, self._lens, config, self.sigma_px)
        finder.remember(ids, uv, self.state)
        return ids, uv
