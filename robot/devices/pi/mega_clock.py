"""The Mega's 32-bit microseconds in the Pi's monotonic nanoseconds. Pure: arrival times are arguments."""

from __future__ import annotations

from shared.clock import RemoteClock

WRAP = 1 << 32
# From the data-ready interrupt to the last bit on the line: burst 0.8 ms, packing 1 ms, 37 bytes at 500 kBd 0.75 ms
# (`least_delay_us` of the emulated board, which counts a bit per byte more). No one-way method can see this part of the
# delay by itself.
LEAST_DELAY_NS = 2_550_000


class MegaClock:
    """Unwraps the Mega's clock (every 71.6 minutes) and keeps its offset and drift by the quickest arrivals."""

    def __init__(self, least_delay_ns: int = LEAST_DELAY_NS) -> None:
        self._least_delay_ns = least_delay_ns
        self._clock = RemoteClock()
        self._last_us: int | None = None
        self._last_ns = 0

    @property
    def drift_ppm(self) -> float | None:
        """How much faster the Mega's resonator runs than our clock; None before the first arrival."""
        return None if self._clock.fit is None else self._clock.fit.drift_ppm

    def at(self, t_us: int, t_arrival_ns: int) -> int:
        """Our time of a stamp within half a wrap of the last one; its arrival while no sample has told the clock."""
        if self._last_us is None or self._clock.fit is None:
            return t_arrival_ns
        return self._clock.fit.to_local_ns(1000 * self._unwrapped(t_us, self._last_us))

    def stamp(self, t_us: int, t_arrival_ns: int) -> int:
        """Our time of the Mega's stamp `t_us`, whose packet arrived at `t_arrival_ns`. Never runs backwards."""
        self._last_us = t_us if self._last_us is None else self._unwrapped(t_us, self._last_us)
        t_mega_ns = self._last_us * 1000
        self._clock.add(t_mega_ns, t_arrival_ns - self._least_delay_ns)
        fit = self._clock.fit
        assert fit is not None
        self._last_ns = max(self._last_ns + 1, fit.to_local_ns(t_mega_ns))
        return self._last_ns

    @staticmethod
    def _unwrapped(t_us: int, before_us: int) -> int:
        """With as many wraps as it takes to lie next to the one before."""
        return before_us + (t_us - before_us + WRAP // 2) % WRAP - WRAP // 2
