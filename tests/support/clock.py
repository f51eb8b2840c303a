"""Stamps fed to the clock estimate."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from shared.clock import RemoteClock

S = 1_000_000_000


def feed(clock: RemoteClock, drift_ppm: float, offset_ns: int, kind: str, seed: int, seconds: float = 30.0) -> int:
    """Send 30 stamps a second; returns the last remote time."""
    rng = np.random.default_rng(seed)
    count = int(seconds * 30)
    local_ns = (np.arange(count) * S / 30).astype(np.int64)
    remote_ns = local_ns + np.rint(local_ns * drift_ppm * 1e-6).astype(np.int64)
    arrival_ns = local_ns + jitter_ns(kind, count, rng).astype(np.int64)
    for remote, arrival in zip(remote_ns.tolist(), arrival_ns.tolist(), strict=True):
        clock.add(remote - offset_ns, arrival)
    return int(remote_ns[-1]) - offset_ns


MS = 1_000_000


def jitter_ns(kind: str, count: int, rng: np.random.Generator) -> npt.NDArray[np.float64]:
    """Delays above the least one, as a home network makes them."""
    delay = {"exponential": rng.exponential(2.0, count), "uniform": rng.uniform(0.0, 5.0, count)}
    delay["spiky"] = delay["exponential"] + (rng.random(count) < 0.1) * rng.exponential(50.0, count)
    return delay[kind] * MS
