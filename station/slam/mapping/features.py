"""Features of a keyframe, as far as matching and mapping need them; whoever finds them (sift.py, ukf/views.py)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from shared.geometry import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Features:
    """Of one image."""

    uv_px: FloatArray  # (N, 2) as seen: distorted pixels
    sift: npt.NDArray[np.uint8]  # (N, 128) RootSIFT of any length: a quarter of what unit vectors take

    def __len__(self) -> int:
        return len(self.uv_px)

    @property
    def descriptors(self) -> npt.NDArray[np.float32]:
        """(N, 128) of length 1; made anew each time."""
        found = self.sift.astype(np.float32)
        return found / np.maximum(np.linalg.norm(found, axis=1, keepdims=True), 1e-9)
