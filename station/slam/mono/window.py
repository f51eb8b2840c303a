"""Some images once more: the same filter, its derivatives taken where it ended instead of where it guessed.

While little has moved, an image shows inverse depth times velocity, both unknown, and derivatives at first guesses make
the filter far too sure of them. So it goes back through its measurements, and forward again from before them with the
derivatives of that path; where most features are new also from the mirror image of that path. What fits better stays.
Source: the iterated extended Kalman smoother, Bell, SIAM J. Optimization 4(3), 1994: a Gauss-Newton step a round. Its
smoother: Bierman, Automatica 9(5), 1973; no measurement counts twice, and only means go back.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg

from shared.geometry import FloatArray, IntArray, so3_exp
from station.slam.mono.config import MonoConfig
from station.slam.mono.measurement import Predicted, first_seen, predict
from station.slam.mono.motion import CAMERA, POSE, POSITION
from station.slam.mono.state import State
from station.vision.bearings import angles_of, bearing
from station.vision.innovations import whitened
from station.vision.lens import Lens

MAX_ROUNDS = 8  # less where the errors no longer change
SETTLED = 0.3  # change of chi-square: the path moved by half a sigma
NOISE_SETTLED = 0.1  # change of the noise, of itself
BAD_SIGMAS = 2.0  # a feature whose errors are larger on the mean is no fixed point
MIN_FREE = 60  # degrees of freedom; fewer say too little of the noise
NONE = np.zeros((0, 6, POSE))  # derivatives of no new features
MEDIAN_CHI2 = 1.386  # of two degrees of freedom


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """What one image gave."""

    dt_s: float  # since the image before
    ids: IntArray  # (K,) features that took part, and new ones
    uv_px: FloatArray  # (K, 2)
    wanted: IntArray  # features that should have been in it

    def only(self, ids: IntArray) -> Measured:
        keep = np.isin(self.ids, ids)
        return replace(self, ids=self.ids[keep], uv_px=self.uv_px[keep])


class Window:
    """Some images in a row, from a state before the first of them, and what they say together."""

    def __init__(self, lens: Lens, config: MonoConfig, first: State, images: list[Measured]) -> None:
        self._lens, self._config, self._first, self._images = lens, config, first, images

    def again(self, state: State, sigma_px: float) -> tuple[list[State], float]:
        """The states after each image, the last one honest of its errors; and the noise that was left, px."""
        ids = np.concatenate([image.ids for image in self._images])
        paths = [self._back(state.only(ids), sigma_px)]  # no other features say where the camera was
        if np.isin(ids, self._first.ids).sum() < len(ids) / 2:
            paths.append([mirrored(past, self._first) for past in paths[0]])
        path, sigma_px, _ = min((self._settled(each, sigma_px) for each in paths), key=lambda found: found[2])
        good = path[-1].ids
        images = [image.only(good) for image in self._images]
        first = self._first.only(np.setdiff1d(state.ids, np.setdiff1d(ids, good)))  # with those that were not seen
        return self._round(first, images, path, sigma_px)[0], sigma_px

    def _settled(self, path: list[State], sigma_px: float) -> tuple[list[State], float, float]:
        """Where rounds from this path lead; the noise, px; the squared errors, px^2, also of what is left out."""
        good, before = path[-1].ids, np.inf
        for _ in range(MAX_ROUNDS):
            images = [image.only(good) for image in self._images]
            path, chi2 = self._round(self._first.only(good), images, path, sigma_px)
            change, before, square = abs(chi2 - before), chi2, chi2 * sigma_px**2
            if change > SETTLED:  # noise is measured, and features are judged, where the path is known
                continue
            squares, rows = self._errors(images, path)
            free, was_px = 2 * len(rows) - POSE * len(path) - 3 * len(good), sigma_px
            if free > MIN_FREE:
                noise_px = float(np.sqrt(np.median(squares) / MEDIAN_CHI2 * 2 * len(rows) / free))
                sigma_px = max(noise_px, self._config.min_sigma_px)
            mean = np.bincount(rows, squares, len(good)) / np.maximum(2 * np.bincount(rows, minlength=len(good)), 1)
            is_bad = mean > (BAD_SIGMAS * sigma_px) ** 2
            if not is_bad.any() and abs(sigma_px - was_px) < NOISE_SETTLED * was_px:
                break
            good = good[~is_bad]
        left_out = sum(len(image.ids) - len(kept.ids) for image, kept in zip(self._images, images, strict=True))
        return path, sigma_px, square + left_out * 2 * (BAD_SIGMAS * sigma_px) ** 2

    def _back(self, state: State, sigma_px: float) -> list[State]:
        """From the last image to the first one; in the order of time."""
        path = [state]
        for image, before in zip(self._images[:0:-1], self._images[-2::-1], strict=True):
            state, _ = state.moved(self._config, -image.dt_s)
            rows = np.searchsorted(state.ids, before.ids)
            state = state.updated(state.expect(self._lens, rows, sigma_px), before.uv_px)
            path.append(state)
        return path[::-1]

    def _round(
        self, state: State, images: list[Measured], path: list[State], sigma_px: float
    ) -> tuple[list[State], float]:
        """From before the first image to the last one, with derivatives taken on the path; the path that this makes
        most probable, and chi-square of all that was assumed."""
        config, rho, steps, chi2 = self._config, self._config.first_inverse_depth, [], 0.0
        for image, at, seen in zip(images, path, self._seen(images, path), strict=True):
            state, F = state.moved(config, image.dt_s)
            rows = np.searchsorted(state.ids, image.ids)
            old = int((rows < len(state.ids)).sum())  # new ones come after them
            expected = state.expect(self._lens, rows[:old], sigma_px, (at, seen.of(slice(old))))
            L, HP, nu = whitened(expected.S, expected.HP, image.uv_px[:old] - expected.uv_px)
            chi2 += float(nu @ nu)
            state, new, uv = state.updated_by(HP, nu), image.ids[old:], image.uv_px[old:]
            by_pose = first_seen(state.x[POSITION], state.R, uv, rho, self._lens)[1] if len(new) else NONE
            state = state.with_features(new, uv, at.noise[np.searchsorted(at.ids, new)], self._lens, config, sigma_px)
            steps.append((F, expected, L, HP, nu, by_pose, state))
        # What later images say of each number: P times this is the step that they ask for.
        path, later = [], np.zeros(len(state.x))
        for F, expected, L, HP, nu, by_pose, state in reversed(steps):
            path.append(state.shifted(state.P @ later))
            later, of_new = np.split(later, [HP.shape[1]])
            later[:POSE] += by_pose.reshape(-1, POSE).T @ of_new
            asked = scipy.linalg.solve_triangular(L, nu - HP @ later, trans=1, lower=True, check_finite=False)
            later += np.bincount(expected.columns.ravel(), (expected.H * asked[:, None]).ravel(), len(later))
            later[:CAMERA] = F.T @ later[:CAMERA]
        return path[::-1], chi2

    def _seen(self, images: list[Measured], path: list[State]) -> list[Predicted]:
        """What each image should show where the camera is on the path; in one call, which costs more than an image."""
        rows = [np.searchsorted(at.ids, image.ids) for image, at in zip(images, path, strict=True)]
        size = [len(row) for row in rows]
        r, R = np.repeat([at.x[POSITION] for at in path], size, axis=0), np.repeat([at.R for at in path], size, axis=0)
        y = np.concatenate([at.features()[row] for at, row in zip(path, rows, strict=True)])
        is_inverse = np.concatenate([at.is_inverse[row] for at, row in zip(path, rows, strict=True)])
        seen, ends = predict(r, R, y, is_inverse, self._lens), np.cumsum(size).tolist()
        return [seen.of(slice(start, end)) for start, end in zip([0, *ends], ends, strict=False)]

    def _errors(self, images: list[Measured], path: list[State]) -> tuple[FloatArray, IntArray]:
        """Squared errors (K,) px^2 of all measurements, as if of noise 1, and their features' rows (K,)."""
        row = np.concatenate([np.searchsorted(path[-1].ids, image.ids) for image in images])
        seen = np.concatenate([each.uv_px for each in self._seen(images, path)])
        error = np.concatenate([image.uv_px for image in images]) - seen
        return np.einsum("ki,kij,kj->k", error, np.linalg.inv(path[-1].noise)[row], error), row


def mirrored(state: State, first: State) -> State:
    """The world that moves alike in the images: near and far exchanged, the camera on the other side, and turned.

    Seen by the first camera, a pixel moves to first order by rho (-V_x, -V_y) + (-Omega_y, Omega_x), the same for
    2 mean - rho, -V and Omega + 2 mean (-V_y, V_x): a relief reversed. Features that were known at first stay.
    """
    new = state.is_inverse & ~np.isin(state.ids, first.ids)
    y, r, R = state.features()[new], first.x[POSITION], first.R
    middle, other_side = float(np.median(y[:, 5])), np.array([-1.0, -1.0, 1.0])

    def turn(p: FloatArray) -> FloatArray:
        return so3_exp(2.0 * middle * np.stack([-p[..., 1], p[..., 0], 0.0 * p[..., 2]], axis=-1))

    origin, camera = (y[:, :3] - r) @ R, (state.x[POSITION] - r) @ R
    away = np.einsum("nij,nj->ni", turn(origin), bearing(y[:, 3:5]) @ R) @ R.T
    rho = np.maximum(2.0 * middle - y[:, 5], 0.1 * middle)
    x = state.x.copy()
    x[state.rows()[new]] = np.column_stack([origin * other_side @ R.T + r, angles_of(away)[0], rho])
    x[POSITION] = camera * other_side @ R.T + r
    return replace(state, x=x, R=R @ turn(camera) @ R.T @ state.R)
