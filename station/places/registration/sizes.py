"""Which scales to consider, by the sizes of the clouds; and what odd sizes say of their units."""

from __future__ import annotations

from shared.errors import DataError, DegenerateGeometry
from shared.geometry import FloatArray, median_radius
from station.places.registration.result import Scale

FREE_SCALE_RANGE = (0.78, 1.28)  # clouds in one unit: the scale drift of visual SLAM, and a margin
ARBITRARY_SCALE_RANGE = (0.55, 1.8)  # about the ratio of the sizes, when a gauge is arbitrary
MAX_SIZE_RATIO = 4.0  # parts of one flat in one unit differ less in size
UNIT_RATIO = 30.0  # from here on sizes in one unit are not even searched; an inch is a 39th of a metre
ODD_RATIO = 2.0  # from here on a refusal mentions the sizes: a foot is a third of a metre


def scale_range_of(
    target: FloatArray, source: FloatArray, scale: Scale, given: tuple[float, float] | None, *, search: bool
) -> tuple[float, float]:
    """Smallest and largest scale to consider. Raises DegenerateGeometry when known scales cannot be right.

    Without a search something else vouches for them: a room may be a small part of a large map.
    """
    ratio = median_radius(target) / median_radius(source)
    odd = not 1 / MAX_SIZE_RATIO < ratio < MAX_SIZE_RATIO
    if scale == "known":
        if search and not 1 / UNIT_RATIO < ratio < UNIT_RATIO:
            raise DegenerateGeometry(
                f"{_larger(ratio)}: the clouds seem to be in different units; convert one, or use scale free"
            )
        return (1.0, 1.0)
    if given is not None:
        if not 0 < given[0] <= given[1]:
            raise DataError(f"scale_range {given} must be two positive numbers, smaller first")
        return given
    low, high = ARBITRARY_SCALE_RANGE if odd else FREE_SCALE_RANGE
    return (ratio * low, ratio * high) if odd else (low, high)


def odd_sizes(target: FloatArray, source: FloatArray, scale: Scale, scales: tuple[float, float]) -> tuple[str, ...]:
    """What else a refusal may come from: a unit, where sizes differ by more than the scales that were tried."""
    ratio = median_radius(target) / median_radius(source)
    if 1 / ODD_RATIO < ratio < ODD_RATIO or scales[0] <= ratio <= scales[1]:
        return ()
    remedy = f", as scales of {scales[0]:.3g} to {scales[1]:.3g} were tried"
    if scale == "known":
        low, high = scale_range_of(target, source, "free", None, search=True)
        remedy = ", or use scale free" if low <= ratio <= high else ""
    return (f"{_larger(ratio)}: if they are in different units, convert one{remedy}",)


def _larger(ratio: float) -> str:
    """Which cloud is how much larger; `ratio` is the target's size by the source's."""
    if ratio >= 1:
        return f"the target is {ratio:.3g} times the source's size"
    return f"the source is {1 / ratio:.3g} times the target's size"
