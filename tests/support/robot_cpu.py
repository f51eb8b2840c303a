"""Judging a measurement of robot-server."""

from __future__ import annotations

LEAST_RATE_HZ = 27.0


def starved(result: dict[str, object]) -> list[str]:
    """The measurements in which this PC could not even make the frames in time."""
    rates = {
        name: value["frames_per_s"]
        for name, value in result.items()
        if isinstance(value, dict) and "frames_per_s" in value
    }
    return [name for name, rate in rates.items() if rate < LEAST_RATE_HZ]
