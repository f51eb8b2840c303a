"""Appearance index: which images of a map look like this one. Visual words, trained on the map itself, inverted file.

The number of words grows with the map, so an inverted list keeps its length; a word is found through two levels in
the square root of their number. A query therefore costs much less than the map's size.
Source: Sivic and Zisserman, ICCV 2003 (words, tf-idf); Nister and Stewenius, CVPR 2006 (hierarchy).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_array

from shared.geometry import FloatArray, IntArray
from station.vision.features import DescriptorArray, Float32Array, to_floats

DESCRIPTORS_PER_WORD = 12
MAX_WORDS = 1 << 18
TRAINING_LIMIT = 200_000  # descriptors; a random sample of larger maps
LLOYD_ROUNDS = 6
NEAREST_AT_ONCE = 2048  # rows of scores, which stay in the processor's cache
AT_ONCE = 1 << 18  # descriptors held as floats: a large map's would take four times its memory


@dataclass(frozen=True, slots=True, eq=False)
class Vocabulary:
    """Two levels of cluster centres. Word numbers run through the cells of the first level."""

    coarse: Float32Array  # (c, 128)
    fine: Float32Array  # (w, 128) grouped by coarse cell
    first: IntArray  # (c + 1,) where each coarse cell's words begin
    half_norm: Float32Array  # (w,) of the fine ones: at each question it would cost as much as the answer

    @classmethod
    def of(cls, coarse: Float32Array, fine: Float32Array, first: IntArray) -> Vocabulary:
        return cls(coarse, fine, first, _half_norm(fine))

    @property
    def num_words(self) -> int:
        return len(self.fine)

    def words(self, descriptors: DescriptorArray) -> IntArray:
        """(n,) the word of each descriptor (n, 128)."""
        out = np.zeros(len(descriptors), dtype=np.int64)
        for start in range(0, len(descriptors), AT_ONCE):
            out[start : start + AT_ONCE] = self._words(to_floats(descriptors[start : start + AT_ONCE]))
        return out

    def _words(self, x: Float32Array) -> IntArray:
        cell = _nearest(x, self.coarse)
        order = np.argsort(cell, kind="stable")
        cells, begin = np.unique(cell[order], return_index=True)
        out = np.zeros(len(x), dtype=np.int64)
        for c, mine in zip(cells.tolist(), np.split(order, begin[1:]), strict=True):
            words = slice(self.first[c], self.first[c + 1])
            out[mine] = self.first[c] + _nearest(x[mine], self.fine[words], self.half_norm[words])
        return out


def train_vocabulary(descriptors: DescriptorArray, seed: int = 0) -> Vocabulary:
    """Words for the descriptors (n, 128) of a map: about one per DESCRIPTORS_PER_WORD of them."""
    rng = np.random.default_rng(seed)
    total = len(descriptors)
    num_words = int(np.clip(total // DESCRIPTORS_PER_WORD, 1, MAX_WORDS))
    sample = descriptors if total <= TRAINING_LIMIT else descriptors[rng.choice(total, TRAINING_LIMIT, replace=False)]
    x = to_floats(sample)
    coarse = _cluster(x, max(1, round(np.sqrt(num_words))), rng)
    cell = _nearest(x, coarse)
    fine, first = [], [0]
    for c in range(len(coarse)):
        mine = x[cell == c]
        count = max(1, round(num_words * len(mine) / len(x)))
        centres = _cluster(mine, count, rng) if len(mine) else coarse[c : c + 1]
        fine.append(centres)
        first.append(first[-1] + len(centres))
    return Vocabulary.of(coarse, np.concatenate(fine), np.array(first, dtype=np.int64))


def _half_norm(centres: Float32Array) -> Float32Array:
    """(k,) half the squared length of each centre (k, 128)."""
    out = np.empty(len(centres), dtype=np.float32)
    for start in range(0, len(centres), 8192):
        out[start : start + 8192] = 0.5 * (centres[start : start + 8192] ** 2).sum(axis=1)
    return out


def _nearest(x: Float32Array, centres: Float32Array, half_norm: Float32Array | None = None) -> IntArray:
    """Index of the nearest centre (k, 128) to each row of x (n, 128)."""
    half_norm = _half_norm(centres) if half_norm is None else half_norm
    out = np.empty(len(x), dtype=np.int64)
    room = np.empty((min(NEAREST_AT_ONCE, len(x)), len(centres)), dtype=np.float32)
    for start in range(0, len(x), NEAREST_AT_ONCE):
        rows = x[start : start + NEAREST_AT_ONCE]
        score = np.matmul(rows, centres.T, out=room[: len(rows)])
        score -= half_norm
        np.argmax(score, axis=1, out=out[start : start + len(rows)])
    return out


def _cluster(x: Float32Array, count: int, rng: np.random.Generator) -> Float32Array:
    """Lloyd's k-means from random members; fewer centres than asked when there are fewer points."""
    count = min(count, len(x))
    centres = x[rng.choice(len(x), count, replace=False)]
    if count == len(x):
        return centres
    ones, rows = np.ones(len(x), dtype=np.float32), np.arange(len(x) + 1)
    for _ in range(LLOYD_ROUNDS):
        label = _nearest(x, centres)
        sums = csr_array((ones, label, rows), shape=(len(x), count)).T @ x  # far quicker than np.add.reduceat
        size = np.bincount(label, minlength=count)
        filled = size > 0
        centres = centres.copy()
        centres[filled] = sums[filled] / size[filled, None]
    return np.asarray(centres, dtype=np.float32)


class AppearanceIndex:
    """Inverted file over images: word → the images that show it."""

    def __init__(self, images: Sequence[DescriptorArray], seed: int = 0) -> None:
        """Index the images' descriptors, each (n_i, 128); an image without any can never be proposed."""
        self.num_images = len(images)
        stacked = np.concatenate([np.zeros((0, 128), dtype=np.uint8), *images])
        if not len(stacked):
            self._vocabulary: Vocabulary | None = None
            return
        self._vocabulary = train_vocabulary(stacked, seed)
        word = self._vocabulary.words(stacked)
        image = np.repeat(np.arange(len(images)), [len(d) for d in images])
        pair, count = np.unique(word * np.int64(len(images)) + image, return_counts=True)
        pair_word, self._posting_image = pair // len(images), pair % len(images)
        num_words = self._vocabulary.num_words
        self._begin = np.searchsorted(pair_word, np.arange(num_words + 1))
        in_images = np.diff(self._begin)
        # A word seen in most images says nothing.
        self._idf = np.log((1 + len(images)) / (1 + in_images)) * (in_images > 0)
        weight = np.sqrt(count) * self._idf[pair_word]
        norm = np.sqrt(np.bincount(self._posting_image, weight**2, minlength=len(images)))
        self._posting_weight = weight / np.maximum(norm[self._posting_image], 1e-12)

    def arrays(self) -> dict[str, npt.NDArray[np.generic]]:
        """The whole index; `of_arrays` makes it again."""
        v = self._vocabulary
        if v is None:
            return {}
        return {
            "coarse_words": v.coarse,
            "words": v.fine,
            "first_word": v.first,
            "posting_image": self._posting_image,
            "posting_weight": self._posting_weight,
            "first_posting": self._begin,
            "word_idf": self._idf,
        }

    @classmethod
    def of_arrays(cls, num_images: int, arrays: Mapping[str, npt.NDArray[np.generic]]) -> AppearanceIndex:
        """What `arrays` gave, over as many images. Raises KeyError, ValueError when these are others."""
        index = cls(())
        index.num_images = num_images
        if "words" in arrays:
            coarse, fine = (arrays[name].astype(np.float32, copy=False) for name in ("coarse_words", "words"))
            index._vocabulary = Vocabulary.of(coarse, fine, arrays["first_word"].astype(np.int64, copy=False))
            index._posting_image = arrays["posting_image"].astype(np.int64, copy=False)
            index._posting_weight = arrays["posting_weight"].astype(np.float64, copy=False)
            index._begin = arrays["first_posting"].astype(np.int64, copy=False)
            index._idf = arrays["word_idf"].astype(np.float64, copy=False)
        return index

    @property
    def num_words(self) -> int:
        return self._vocabulary.num_words if self._vocabulary else 0

    @property
    def num_bytes(self) -> int:
        """Memory of the index without the descriptors themselves."""
        v = self._vocabulary
        if v is None:
            return 0
        arrays = (
            v.coarse,
            v.fine,
            v.half_norm,
            v.first,
            self._posting_image,
            self._posting_weight,
            self._begin,
            self._idf,
        )
        return sum(a.nbytes for a in arrays)

    def query(self, descriptors: DescriptorArray, count: int) -> tuple[IntArray, FloatArray]:
        """The most similar images: numbers (k,) and cosine similarities (k,), best first; k <= count."""
        if self._vocabulary is None or not len(descriptors):
            return np.zeros(0, dtype=np.int64), np.zeros(0)
        word, times = np.unique(self._vocabulary.words(descriptors), return_counts=True)
        weight = np.sqrt(times) * self._idf[word]
        norm = float(np.linalg.norm(weight))
        if norm <= 0:
            return np.zeros(0, dtype=np.int64), np.zeros(0)
        begin, end = self._begin[word], self._begin[word + 1]
        length = end - begin
        posting = np.repeat(begin - np.cumsum(length) + length, length) + np.arange(length.sum())
        contribution = self._posting_weight[posting] * np.repeat(weight / norm, length)
        image, inverse_index = np.unique(self._posting_image[posting], return_inverse=True)
        score = np.bincount(inverse_index, contribution, minlength=len(image))
        best = np.argsort(-score, kind="stable")[:count]
        return image[best].astype(np.int64), score[best].astype(np.float64)
