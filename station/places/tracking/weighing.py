"""What an image's verified poses say about where the robot is: Bayes' rule over the hypotheses, and what counts as new.

Images are not independent: a piece of furniture that looks like another one deceives every image of it. So an image is
evidence for what it recognises that was not recognised before, and small things together have one budget.
docs/localisation.md explains the rule.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from shared.geometry import FloatArray, inverse
from station.model.place_answer import Localization
from station.places.localisation.recognised import NOTHING, Recognised
from station.places.tracking.belief import Agreement, BeliefConfig, Hypothesis, agreement, fused, in_units
from station.places.tracking.likelihoods import Shown
from station.places.tracking.map_view import MapView

SAME_POSE = 36.0  # squared Mahalanobis distance: 6 sigma; tails are long


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """A localisation in the terms of the estimator."""

    localization: Localization
    map_index: int
    view: MapView  # of that map
    T_map_body: FloatArray  # (4, 4) map units
    sigma_m: float
    shown: Shown


@dataclass(frozen=True, slots=True, eq=False)
class Weights:
    """What the robot may be, with weights: at a tracked pose, somewhere in a map, where no map knows."""

    hypotheses: list[Hypothesis]
    lost: float
    unmapped: float


def weighed(
    measured: Sequence[Measured],
    before: Weights,
    T_nav_body: FloatArray,
    freshness: float,
    numbers: Iterator[int],
    c: BeliefConfig,
) -> Weights:
    """The weights, not normalised, after an image that was taken at one of several poses, or (`false`) at none of them.

    Its likelihood at a pose is a mixture: the candidates' densities (Student's t) there; a uniform one; and, as what
    looks alike deceives again and again, the candidates' densities at the pose of another hypothesis, as far as that
    one is a look-alike's. What was "lost" goes to the candidates by their shares: to the hypothesis that expects one,
    else to a new one with the next of the `numbers`. Where no map knows, a first candidate is as likely as strays are
    there. `freshness`: 0..1, how far the view is another one than the last image's.
    """
    odds = np.exp([c.right.log_odds(m.shown) for m in measured])
    false = max(1.0 / (1.0 + float(odds.sum())), c.false_localization_floor)
    share = odds / odds.sum()
    fits = [[_fit(h, m, T_nav_body, c) for m in measured] for h in before.hypotheses]
    density = np.array([[fit.density for fit in row] for row in fits]).reshape(len(fits), len(measured)) * share
    at = density.sum(axis=1)  # of the image, at each hypothesis
    repeats = at * np.array([h.look_alike for h in before.hypotheses])
    again = c.deceived_again
    says = float(np.log((1 - false) / (false * again)))  # log odds, for a hypothesis that it fits
    freshness = min(freshness, _novelty(measured, before, fits, share, says, c))
    counted = freshness * max(0.0, says)
    believed = 1 - false**freshness  # of the weight of "lost" that turns to the candidates
    found = before.lost * believed * share  # weight (candidates,): it was lost, and is there
    expected = [_expects(fits, j) for j in range(len(measured))]
    hypotheses = []
    for i, h in enumerate(before.hypotheses):
        elsewhere = float(np.delete(repeats, i).max(initial=0.0))
        likelihood = (1 - false) * at[i] + false * (1 - again + again * elsewhere)
        h = replace(h, weight=h.weight * float(likelihood) ** freshness)
        best = int(np.argmax(density[i]))
        if fits[i][best].squared < SAME_POSE:
            h = _corrected(h, measured[best], fits[i][best], T_nav_body, counted, c)
        hypotheses.append(replace(h, weight=h.weight + float(found[[e == i for e in expected]].sum())))
    repeated = 1 - again + again * float(repeats.max(initial=0.0))
    likeliest = int(np.argmax(share))
    strayed = _rarer(measured[likeliest], c) if expected[likeliest] is None else false
    for m, weight, expecting in zip(measured, found, expected, strict=True):
        if expecting is None:
            started = _started(m, T_nav_body, float(weight), counted, c)
            hypotheses.append(replace(started, number=next(numbers)))
    lost, unmapped = before.lost * (false * repeated) ** freshness, before.unmapped * (strayed * repeated) ** freshness
    return Weights(hypotheses, lost, unmapped)


def weighed_failure(
    before: Weights,
    in_view: Sequence[float | None],
    num_features: int,
    failed_before: float,
    freshness: float,
    c: BeliefConfig,
) -> Weights:
    """The weights, not normalised, after an image that was not recognised.

    `in_view`: how many landmarks should be in view at each hypothesis (`Coverage.in_view`), None where nobody knows.
    """
    somewhere = c.fails_in_map.probability(num_features, failed_before)
    hypotheses = []
    for h, count in zip(before.hypotheses, in_view, strict=True):
        at = somewhere if count is None else c.fails_at_pose.probability(num_features, failed_before, count)
        hypotheses.append(replace(h, weight=h.weight * at**freshness))
    nowhere = c.fails_unmapped.probability(num_features, failed_before)
    return Weights(hypotheses, before.lost * somewhere**freshness, before.unmapped * nowhere**freshness)


def _rarer(m: Measured, c: BeliefConfig) -> float:
    """How much rarer an image with such a best candidate is where no map knows than somewhere in a map."""
    return float(np.clip(np.exp(c.unmapped.log_odds(m.shown)), c.false_localization_floor, 1.0))


def _fit(h: Hypothesis, m: Measured, T_nav_body: FloatArray, c: BeliefConfig) -> Agreement:
    """How well a measured pose fits a hypothesis; in another map not at all."""
    if h.map_index != m.map_index:
        return Agreement(np.inf, 0.0)
    sigma_m = float(np.hypot(h.sigma_m, m.sigma_m))
    sigma_rad = float(np.hypot(h.sigma_rad, c.pose_floor_rad))
    return agreement(h.pose(T_nav_body), m.T_map_body, sigma_m, sigma_rad, m.view.area_m2, m.view.unit)


def _corrected(
    h: Hypothesis, m: Measured, fit: Agreement, T_nav_body: FloatArray, counted: float, c: BeliefConfig
) -> Hypothesis:
    """The hypothesis after a measurement that it expected."""
    gain = h.sigma_m**2 / (h.sigma_m**2 + fit.doubt * m.sigma_m**2)
    gain_heading = h.sigma_rad**2 / (h.sigma_rad**2 + fit.doubt * c.pose_floor_rad**2)
    z = m.localization
    before = h.recognised.since(_forgotten(z, c))
    return replace(
        h.moved_to(fused(h.pose(T_nav_body), m.T_map_body, gain, gain_heading), T_nav_body),
        sigma_m=float(np.sqrt(max(1 - gain, 0.05))) * h.sigma_m,
        sigma_rad=float(np.sqrt(max(1 - gain_heading, 0.05))) * h.sigma_rad,
        evidence_t_robot_ns=z.t_robot_ns,
        evidence_keyframe=z.keyframe_index,
        inliers=z.num_inliers,
        recognised=before.and_then(z.landmarks, z.t_robot_ns),
        credited=(h.credited if before.seen else 0.0) + counted,
        look_alike=1.0,
    )


def _started(m: Measured, T_nav_body: FloatArray, weight: float, counted: float, c: BeliefConfig) -> Hypothesis:
    """A new hypothesis: the robot is where this measurement says."""
    z = m.localization
    return Hypothesis(
        map_index=m.map_index,
        T_map_nav=m.T_map_body @ inverse(in_units(T_nav_body, m.view.unit)),
        unit=m.view.unit,
        sigma_m=m.sigma_m,
        sigma_rad=c.pose_floor_rad,
        weight=weight,
        evidence_t_robot_ns=z.t_robot_ns,
        evidence_keyframe=z.keyframe_index,
        inliers=z.num_inliers,
        recognised=NOTHING.and_then(z.landmarks, z.t_robot_ns),
        credited=counted,
    )


def _novelty(
    measured: Sequence[Measured],
    before: Weights,
    fits: list[list[Agreement]],
    share: FloatArray,
    says: float,
    c: BeliefConfig,
) -> float:
    """Weight 0..1 of an image as evidence: the share of the landmarks it recognises that no hypothesis did lately.

    While all that a hypothesis recognised is small enough for furniture that comes twice, the whole has a budget: what
    is as large as it is worth, of which the image may count what was not counted yet. `says`: what it is worth by
    itself (log odds). Of several candidates those count that are probably true.
    """
    surely = np.log(1 / c.false_localization_floor - 1)  # no look-alike is as large: images err one by one
    weight, novelty = [], []
    for j, m in enumerate(measured):
        z = m.localization
        expecting = _expects(fits, j)
        h = None if expecting is None else before.hypotheses[expecting]
        # What any of them recognised is no news to this one: a look-alike's pose may scatter.
        new = max(_recognised_before(before.hypotheses, m, c).share_of_new(z.landmarks), c.same_landmarks)
        had = NOTHING if h is None else _recognised_before((h,), m, c)
        together = had.and_then(z.landmarks, z.t_robot_ns)
        extent_m = together.extent(m.view.place_map.navigation.landmarks.p_world) / m.view.unit
        worth = max(0.0, c.right.log_odds(replace(m.shown, extent_m=extent_m)))
        worth -= float(np.log(c.deceived_again))  # as in what an image says: half of the look-alikes fit no hypothesis
        if h is not None and had.seen and says > 0 and worth < surely:
            new = min(new, max(0.0, worth - h.credited) / says)
        novelty.append(new)
        weight.append(share[j] * (before.lost if h is None else h.weight))
    return float(np.clip(np.average(novelty, weights=np.array(weight) + 1e-12), 0.0, 1.0))


def _expects(fits: list[list[Agreement]], candidate: int) -> int | None:
    """The index of the hypothesis that a candidate fits best."""
    by = [i for i, row in enumerate(fits) if row[candidate].squared < SAME_POSE]
    return max(by, key=lambda i: fits[i][candidate].density) if by else None


def _recognised_before(hypotheses: Sequence[Hypothesis], m: Measured, c: BeliefConfig) -> Recognised:
    """By these hypotheses, of the measured one's map."""
    seen = NOTHING
    for h in hypotheses:
        if h.map_index == m.map_index:
            seen |= h.recognised
    return seen.since(_forgotten(m.localization, c))


def _forgotten(z: Localization, c: BeliefConfig) -> int:
    """The robot time up to which landmarks are forgotten when this image comes."""
    return z.t_robot_ns - round(c.landmark_memory_s * 1e9)
