"""Second global start: KISS-Matcher's feature matches, where its wheel exists (Python < 3.13, x86_64)."""

from __future__ import annotations

import importlib.util
import os
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from shared.geometry import FloatArray, se3


def kiss_is_available() -> bool:
    """Whether the optional library can be imported here."""
    return importlib.util.find_spec("kiss_matcher") is not None


def match_features(target: FloatArray, source: FloatArray, *, upright: bool, voxel: float) -> FloatArray | None:
    """One coarse rigid alignment (4, 4), or None. Its own `valid` flag says nothing: judge the result.

    Args:
        target: (N, 3).
        source: (M, 3) in the same unit.
        upright: both have z up, only yaw is free (Quatro).
        voxel: resolution of the features, target units.
    """
    import kiss_matcher

    config = kiss_matcher.KISSMatcherConfig(voxel_size=voxel, use_quatro=upright)
    matcher = kiss_matcher.KISSMatcher(config)
    with _silenced():
        solution = matcher.estimate(list(source.astype(np.float32)), list(target.astype(np.float32)))
    R, t = np.asarray(solution.rotation, dtype=np.float64), np.asarray(solution.translation, dtype=np.float64).ravel()
    if not (np.isfinite(R).all() and np.isfinite(t).all()) or abs(np.linalg.det(R) - 1) > 0.1:
        return None
    return se3(R, t)


@contextmanager
def _silenced() -> Iterator[None]:
    """The library prints from C++, past Python's streams; stdout is for our JSON."""
    saved, sink = (os.dup(1), os.dup(2)), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(sink, 1)
        os.dup2(sink, 2)
        yield
    finally:
        for stream, copy in zip((1, 2), saved, strict=True):
            os.dup2(copy, stream)
            os.close(copy)
        os.close(sink)
