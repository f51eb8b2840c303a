"""When a recorded inertial unit lay still: samples on an even grid, moments of motion, rests."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from shared.errors import DataError
from shared.geometry import FloatArray, IntArray
from station.model.frames import ImuBatch

WINDOW_S = 1.0  # long enough for 50 samples at 50 Hz: their scatter is known to 10 %
RESTLESS = 1.6  # scatter of a window over that of quiet ones: six sigmas at 50 samples, more at higher rates
SHORTEST_REST_S = 3.0
TURNED_M_S2 = 0.17  # change of the mean force since a rest began, by a tilt of one degree: it lies otherwise
TURNING_RAD_S = 0.02  # of a window's mean rate from the recording's: turning slowly, which does not scatter
BRIDGED_S = 0.5  # gaps up to this are filled with a straight line
QUIET_SHARE = 0.2  # of the windows: those that certainly lay still, if any did
# No such unit is as noisy at rest, in a hand each is: standard deviations within a second. rad/s and m/s^2.
NOISIEST = np.array([0.05] * 3 + [1.0] * 3)


@dataclass(frozen=True, slots=True, eq=False)
class EvenSamples:
    """Samples a constant time apart; what was lost over short gaps is filled in."""

    rate_hz: float
    t_s: FloatArray  # (n,) from the first sample
    values: FloatArray  # (n, 6) gyro rad/s, accelerometer m/s^2
    unbroken: tuple[slice, ...]  # between longer gaps
    num_lost: int  # samples missing in all

    @property
    def duration_s(self) -> float:
        return float(self.t_s[-1])


@dataclass(frozen=True, slots=True)
class Moment:
    """When something moved it."""

    begin_s: float
    end_s: float
    what: str


@dataclass(frozen=True, slots=True, eq=False)
class Stillness:
    """Where it lay still, and when it did not."""

    rests: tuple[slice, ...]  # of the samples; in each it lies as it lay
    moments: tuple[Moment, ...]


def on_even_grid(imu: ImuBatch) -> EvenSamples:
    """Raises DataError: fewer than three samples, or stamps that do not increase."""
    t = imu.t_robot_ns
    steps = np.diff(t)
    if len(t) < 3 or (steps <= 0).any():
        raise DataError("the recording holds fewer than three inertial samples in order of time; record again")
    typical = float(np.median(steps))
    counts = np.maximum(1, np.round(steps / typical)).astype(np.int64)
    regular = counts == 1
    period_s = 1e-9 * float(np.mean(steps[regular]))
    index = np.concatenate([[0], np.cumsum(counts)])
    long = np.flatnonzero(steps > max(1e9 * BRIDGED_S, 1.5 * typical))
    # Long gaps keep no samples: what follows moves up to them, with its own time.
    shift = np.zeros(len(t), dtype=np.int64)
    shift[long + 1] = counts[long] - 1
    packed = index - np.cumsum(shift)
    grid = np.arange(packed[-1] + 1)
    measured = np.hstack([imu.gyro_imu, imu.accel_imu])
    values = np.stack([np.interp(grid, packed, column) for column in measured.T], axis=1)
    t_s = np.interp(grid, packed, 1e-9 * (t - t[0]).astype(np.float64))
    cuts = [0, *packed[long + 1].tolist(), len(grid)]
    unbroken = tuple(slice(a, b) for a, b in pairwise(cuts))
    return EvenSamples(1.0 / period_s, t_s, values, unbroken, int(np.sum(counts - 1)))


@dataclass(frozen=True, slots=True, eq=False)
class _Windows:
    """A recording second by second."""

    start: IntArray  # (w,) first sample
    part: IntArray  # (w,) which unbroken part it is of
    size: int  # samples
    scatter: FloatArray  # (w, 6) standard deviation
    mean: FloatArray  # (w, 6)


def find_stillness(samples: EvenSamples) -> Stillness:
    """Cut a recording into rests. At rest a second scatters no more than the quiet ones, and does not turn."""
    windows = _windows(samples)
    if not len(windows.start):
        return Stillness((), ())
    quiet = np.minimum(np.quantile(windows.scatter, QUIET_SHARE, axis=0), NOISIEST)
    is_calm = (windows.scatter <= RESTLESS * quiet).all(axis=1)
    usual_rate = np.median(windows.mean[is_calm, :3], axis=0) if is_calm.any() else np.zeros(3)
    is_calm &= (np.abs(windows.mean[:, :3] - usual_rate) < TURNING_RAD_S).all(axis=1)
    rests = tuple(_rests(samples, windows, is_calm))
    return Stillness(rests, tuple(_moments(samples, windows, is_calm)))


def _windows(samples: EvenSamples) -> _Windows:
    size = max(8, round(WINDOW_S * samples.rate_hz))
    starts, parts, scatter, mean = [np.empty(0, np.int64)], list[int](), [np.empty((0, 6))], [np.empty((0, 6))]
    for number, part in enumerate(samples.unbroken):
        count = (part.stop - part.start) // size
        blocks = samples.values[part.start : part.start + count * size].reshape(count, size, 6)
        starts.append(part.start + size * np.arange(count))
        parts += [number] * count
        scatter.append(blocks.std(axis=1))
        mean.append(blocks.mean(axis=1))
    return _Windows(
        np.concatenate(starts), np.array(parts, dtype=np.int64), size, np.concatenate(scatter), np.concatenate(mean)
    )


def _rests(samples: EvenSamples, windows: _Windows, is_calm: npt.NDArray[np.bool_]) -> Iterator[slice]:
    """Runs of calm windows without a gap, in which gravity keeps its direction."""
    force = windows.mean[:, 3:]
    first = None
    for i, calm in enumerate(is_calm):
        goes_on = calm and first is not None
        if goes_on:
            follows = windows.part[i] == windows.part[i - 1]
            goes_on = bool(follows and np.linalg.norm(force[i] - force[first]) < TURNED_M_S2)
        if goes_on:
            continue
        if first is not None:
            yield from _long_enough(samples, windows, first, i)
        first = i if calm else None
    if first is not None:
        yield from _long_enough(samples, windows, first, len(is_calm))


def _long_enough(samples: EvenSamples, windows: _Windows, first: int, stop: int) -> Iterator[slice]:
    begin, end = int(windows.start[first]), int(windows.start[stop - 1]) + windows.size
    if (end - begin) / samples.rate_hz >= SHORTEST_REST_S:
        yield slice(begin, end)


def _moments(samples: EvenSamples, windows: _Windows, is_calm: npt.NDArray[np.bool_]) -> Iterator[Moment]:
    """Runs of windows that are not calm, and how strongly it was moved there."""
    bounds = np.flatnonzero(np.diff(np.concatenate([[0], ~is_calm, [0]])))
    for first, stop in bounds.reshape(-1, 2):
        begin, end = int(windows.start[first]), int(windows.start[stop - 1]) + windows.size - 1
        rate = float(windows.scatter[first:stop, :3].max())
        force = float(windows.scatter[first:stop, 3:].max())
        what = f"moved: rates scatter by {rate:.2g} rad/s, forces by {force:.2g} m/s^2"
        yield Moment(float(samples.t_s[begin]), float(samples.t_s[end]), what)
