"""How large a place is."""

from __future__ import annotations

import numpy as np

from shared.geometry import FloatArray

WITHIN = 90.0  # per cent of the landmarks: single stragglers do not make a place larger


def half_extent(p: FloatArray) -> float:
    """Radius about the centroid of points (n, 3) that holds 90 % of them: half the place's extent."""
    return float(np.percentile(np.linalg.norm(p - p.mean(axis=0), axis=1), WITHIN)) if len(p) else 0.0
