"""Some images once more: the same filter, its derivatives taken where it ended instead of where it guessed.

While little has moved, an image shows inverse depth times velocity, both unknown, and a filter that takes derivatives
at its first guesses becomes far too sure of them. So it goes back through its measurements, which says where the
camera was as far as is known by then, and forward again from before them with the derivatives of that path. At the
start it does so a second time from the mirror image of that path, where a Gaussian may have settled, and keeps what
fits better.
Source: the iterated extended Kalman smoother, Bell, SIAM J. Optimization 4(3), 1994: a Gauss-Newton step a round.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from shared.geometry import FloatArray, IntArray, so3_exp
from station.slam.mono.config import FilterConfig
from station.slam.mono.measurement import angles_of, bearing
from station.slam.mono.motion import POSE, POSITION
from station.slam.mono.state import State
from station.vision.lens import Lens

MAX_ROUNDS = 8  # less where the noise no longer changes
SETTLED = 0.05  # relative change of the noise
BAD_SIGMAS = 2.0  # a feature whose errors are larger on the mean is no fixed point


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
    """Some images in a row, and what they say together."""

    def __init__(self, lens: Lens, config: FilterConfig, first: State, images: list[Measured]) -> None:
        """first: before the first image."""
        self._lens, self._config, self._first, self._images = lens, config, first, images

    def again(self, state: State, sigma_px: float, is_start: bool) -> tuple[list[State], float]:
        """The states after each image, the last one honest of its errors; and the noise that was left, px.

        state: after the last image, with its features in the order in which they came.
        is_start: nothing was known before, so it may be the mirror image that is true.
        """
        path = self._back(self._images, state, sigma_px)
        paths = [path, [mirrored(past) for past in path]] if is_start else [path]
        path, sigma_px, _ = min((self._settled(each, sigma_px) for each in paths), key=lambda found: found[2])
        return path, sigma_px

    def _settled(self, path: list[State], sigma_px: float) -> tuple[list[State], float, float]:
        """Where rounds from this path lead; the noise, px; the squared errors, px^2, also of what is left out."""
        good, images, noise_px = path[-1].ids, self._images, np.inf
        for _ in range(MAX_ROUNDS):
            images = [image.only(good) for image in images]
            state = self._forth(images, [past.only(good) for past in path], sigma_px)
            path, before_px = self._back(images, state, sigma_px), noise_px
            noise_px, mean_px2 = self._errors(images, path)
            sigma_px = max(noise_px, self._config.min_sigma_px)
            if abs(noise_px - before_px) < SETTLED * sigma_px:
                break
            good = path[-1].ids[mean_px2 <= (BAD_SIGMAS * sigma_px) ** 2]
        kept, all_ = (sum(len(image.ids) for image in some) for some in (images, self._images))
        cost = kept * noise_px**2 + (all_ - kept) * (BAD_SIGMAS * sigma_px) ** 2
        return [*path[:-1], state], sigma_px, cost

    def _back(self, images: list[Measured], state: State, sigma_px: float) -> list[State]:
        """From the last image to the first one; in the order of time."""
        path = [state]
        for image, before in zip(images[:0:-1], images[-2::-1], strict=True):
            state = self._fuse(state.moved(self._config, -image.dt_s), before, sigma_px)
            path.append(state)
        return path[::-1]

    def _forth(self, images: list[Measured], path: list[State], sigma_px: float) -> State:
        """From the first image to the last one, with derivatives taken on the path."""
        state = self._first.only(path[-1].ids)
        for image, at in zip(images, path, strict=True):
            state = state.moved(self._config, image.dt_s)
            is_new = ~np.isin(image.ids, state.ids)
            state = self._fuse(state, image.only(state.ids), sigma_px, at)
            noise = at.noise[np.searchsorted(at.ids, image.ids[is_new])]
            new = image.ids[is_new], image.uv_px[is_new], noise
            state = state.with_features(*new, self._lens, self._config, sigma_px)
        return state

    def _fuse(self, state: State, image: Measured, sigma_px: float, at: State | None = None) -> State:
        rows = np.searchsorted(state.ids, image.ids)
        return state.updated(state.expect(self._lens, rows, sigma_px, at), image.uv_px)

    def _errors(self, images: list[Measured], path: list[State]) -> tuple[float, FloatArray]:
        """The noise of the measurements, px, without the features that contradict the others; and each one's, px^2."""
        feature = np.concatenate([np.searchsorted(path[-1].ids, image.ids) for image in images])
        seen = [
            state.predict(self._lens).uv_px[np.isin(state.ids, image.ids)]
            for image, state in zip(images, path, strict=True)
        ]
        error = np.concatenate([image.uv_px for image in images]) - np.concatenate(seen)
        count = np.bincount(feature, minlength=len(path[-1].ids))
        squares = np.bincount(feature, ((error / path[-1].noise[feature, None]) ** 2).sum(axis=1), len(count))
        mean = squares / (2 * np.maximum(count, 1))
        good = (mean < BAD_SIGMAS**2 * np.median(mean[feature])) & (count > 0)
        free = 2 * count[good].sum() - POSE * len(path) - 3 * good.sum()
        return float(np.sqrt(squares[good].sum() / max(free, count[good].sum(), 1))), mean


def mirrored(state: State) -> State:
    """The world that moves alike in the images: near and far exchanged, the camera on the other side, and turned.

    To first order a pixel moves by rho (-V_x, -V_y) + (-Omega_y, Omega_x), the same for 2 mean - rho, -V and
    Omega + 2 mean (-V_y, V_x): the reversal of a relief, which only a longer path tells from the truth.
    """
    x, y = state.x.copy(), state.features()
    middle = float(np.median(y[:, 5]))

    def turned(p: FloatArray) -> FloatArray:
        return so3_exp(2.0 * middle * np.stack([-p[..., 1], p[..., 0], 0.0 * p[..., 2]], axis=-1))

    y[:, 3:5] = angles_of(np.einsum("nij,nj->ni", turned(y[:, :3]), bearing(y[:, 3:5])))[0]
    y[:, 5] = np.maximum(2.0 * middle - y[:, 5], 0.1 * middle)
    y[:, :2] *= -1.0
    x[:2] *= -1.0
    x[state.rows()] = y
    return replace(state, x=x, R=turned(state.x[POSITION]) @ state.R)
