"""The filter of the current place: predict, weigh, prune. Pure functions from one belief to the next.

Odometry and time move hypotheses and let weight flow between them, "lost" and "unmapped"; an image multiplies all
weights (`image_evidence.py`), corrects the hypotheses that it fits and starts new ones; what has no weight left goes.
`current.py` calls these in the order of events.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from shared.geometry import FloatArray
from station.places.tracking.belief import Belief, Hypothesis
from station.places.tracking.config import BeliefConfig
from station.places.tracking.image_evidence import ImageLikelihood


def prior(c: BeliefConfig) -> Belief:
    """The belief before the first image."""
    return Belief((), c.prior_lost, c.prior_unmapped)


# -- predict ------------------------------------------------------------------------------------------------------


def predict_motion(before: Belief, distance_m: float, turn_rad: float, c: BeliefConfig) -> Belief:
    """The belief after odometry moved the robot: poses become less certain.

    A robot whose pose nobody knows may have driven out of the map, or into it.
    """
    grown = tuple(h.grown(distance_m, turn_rad, c) for h in before.hypotheses)
    left = 1 - float(np.exp(-c.other_room_per_m * distance_m))
    in_either = before.lost + before.unmapped
    lost = before.lost + left * (c.prior_lost * in_either - before.lost)
    return Belief(grown, lost, before.unmapped + left * (c.prior_unmapped * in_either - before.unmapped))


def predict_blind(before: Belief, seconds: float, c: BeliefConfig) -> Belief:
    """The belief after a time without odometry."""
    return replace(before, hypotheses=tuple(h.blurred(seconds, c) for h in before.hypotheses))


def predict_time(before: Belief, seconds: float, blind_s: float, c: BeliefConfig) -> Belief:
    """The belief after a time, `blind_s` of it without odometry: the robot may have been moved unnoticed.

    Without odometry nothing feels it.
    """
    if blind_s > 0:
        before = predict_blind(before, blind_s, c)
    unfelt_s = c.unfelt * (seconds - blind_s) + blind_s
    stay = float(np.exp(-c.carried_per_s * unfelt_s))
    moved = before.localised * (1 - stay)
    return Belief(
        tuple(replace(h, weight=h.weight * stay) for h in before.hypotheses),
        before.lost + moved * c.prior_lost,
        before.unmapped + moved * c.prior_unmapped,
    )


def predict_hijack(before: Belief, confidence: float, c: BeliefConfig) -> Belief:
    """The belief after the robot was picked up: what was known of its pose counts `1 - confidence`. Not normalised."""
    known = before.localised * confidence
    known += (before.lost + before.unmapped) * confidence
    return Belief(
        tuple(h.begun_anew(1 - confidence) for h in before.hypotheses),
        before.lost * (1 - confidence) + known * c.prior_lost,
        before.unmapped * (1 - confidence) + known * c.prior_unmapped,
    )


def predict_new_frame(
    before: Belief, T_nav_body: FloatArray, T_new_body: FloatArray, gap_s: float, c: BeliefConfig
) -> Belief:
    """The belief after odometry began again in another frame: poses stay where they were, blurred by the gap."""
    moved = (h.moved_to(h.pose(T_nav_body), T_new_body).blurred(gap_s, c) for h in before.hypotheses)
    return replace(before, hypotheses=tuple(moved))


# -- weigh --------------------------------------------------------------------------------------------------------


def weigh(
    before: Belief, image: ImageLikelihood, T_nav_body: FloatArray, numbers: Iterator[int], c: BeliefConfig
) -> Belief:
    """The belief after an image, not normalised: Bayes' rule, and a Kalman update of hypotheses that a candidate fits.

    What was "lost" goes to the candidates by their shares: to the hypothesis that expects one, else to a new one with
    the next of the `numbers`. Where a candidate fits only if the wheels slipped, the hypothesis falls into two: they
    did, or the image is false; where another hypothesis expects the candidate, that one is the slip already.
    """
    found = before.lost * image.found  # (C,) weight: it was lost, and is there
    hypotheses = []
    for i, h in enumerate(before.hypotheses):
        h = replace(h, weight=h.weight * image.at[i], alike=image.alike[i])
        correction = image.corrects[i]
        if correction is not None and not (correction.fit.slipped and image.expected_by[correction.candidate] != i):
            if correction.fit.slipped:
                hypotheses.append(replace(h, weight=h.weight * (1 - correction.probability)))
                h = replace(h, weight=h.weight * correction.probability)
            h = h.corrected(
                image.candidates[correction.candidate],
                correction.fit,
                T_nav_body,
                image.counted_log_odds[correction.candidate],
                c,
            )
        gained = float(found[[expecting == i for expecting in image.expected_by]].sum())
        hypotheses.append(replace(h, weight=h.weight + gained))
    for m, weight, by, counted in zip(image.candidates, found, image.expected_by, image.counted_log_odds, strict=True):
        if by is None:
            hypotheses.append(Hypothesis.started(m, T_nav_body, float(weight), counted, next(numbers)))
    return Belief(tuple(hypotheses), before.lost * image.lost, before.unmapped * image.unmapped)


# -- prune --------------------------------------------------------------------------------------------------------


def prune(before: Belief, c: BeliefConfig) -> Belief:
    """The belief without its lightest hypotheses, normalised."""
    total = before.lost + before.unmapped + sum(h.weight for h in before.hypotheses)
    if total <= 0:  # every explanation was ruled out at once: start over
        return prior(c)
    kept = sorted(before.hypotheses, key=lambda h: -h.weight)[: c.max_hypotheses]
    kept = [h for h in kept if h.weight > 1e-9 * total]
    total = before.lost + before.unmapped + sum(h.weight for h in kept)
    hypotheses = tuple(replace(h, weight=h.weight / total) for h in kept)
    return Belief(hypotheses, before.lost / total, before.unmapped / total)
