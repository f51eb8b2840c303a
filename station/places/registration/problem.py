"""One registration: two clouds made ready, and what is known of how they may lie on each other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shared.geometry import FloatArray, IntArray, transform
from station.places.registration.axes import upright_rotations
from station.places.registration.cloud import PreparedCloud, prepare_cloud

VOXELS = 44  # along the target's larger horizontal extent: 20 cm in a flat of 9 m
COMPARED_POINTS = 200  # source points by which two alignments are compared


@dataclass(frozen=True, slots=True, eq=False)
class RegistrationProblem:
    """What every step works on. Lengths are in target units."""

    target: PreparedCloud
    source: PreparedCloud
    upright: bool  # z is up in both: the tilt is held near zero
    free_scale: bool  # the source's scale is estimated, too
    R_up: FloatArray  # (3, 3) puts the target's vertical along z
    voxel: float  # a length about as large as what the global search leaves open
    rng: np.random.Generator  # of the random subsets

    @property
    def tolerance(self) -> float:
        """How far from a surface its own landmarks lie: three times the noise seen in the clouds."""
        A, B = self.target, self.source
        return 3.0 * max(A.noise, min(B.noise, 2 * A.noise), 0.05 * A.spacing)

    def landed_apart(self, T: FloatArray, other: FloatArray) -> float:
        """Median distance between where two alignments (4, 4) put the source's points."""
        sample = self.source.points[:: max(1, len(self.source.points) // COMPARED_POINTS)]
        return float(np.median(np.linalg.norm(transform(T - other, sample), axis=1)))

    def draw_subsets(self, count: int) -> tuple[IntArray, IntArray]:
        """At most `count` points each of target and source, drawn at random."""
        return self._draw(self.target, count), self._draw(self.source, count)

    def _draw(self, cloud: PreparedCloud, count: int) -> IntArray:
        size = min(count, len(cloud.points))
        return np.sort(self.rng.choice(len(cloud.points), size=size, replace=False))


def make_problem(
    target: FloatArray, source: FloatArray, *, upright: bool, free_scale: bool, rng: np.random.Generator
) -> RegistrationProblem:
    """Prepare clean points (N, 3) and (M, 3)."""
    A, B = prepare_cloud(target, rng), prepare_cloud(source, rng)
    return RegistrationProblem(
        target=A,
        source=B,
        upright=upright,
        free_scale=free_scale,
        R_up=np.eye(3) if upright else upright_rotations(A, B)[0],
        voxel=float(np.max(np.ptp(np.percentile(A.points, [1, 99], axis=0), axis=0)[:2])) / VOXELS,
        rng=rng,
    )
