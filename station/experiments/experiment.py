"""One experiment: a map from Navigation1, Navigation2 matched with it, judged by truth where there is one."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from shared.errors import DataError
from station.datasets import Truth
from station.experiments.matches import MatchJudgement, judge_matches
from station.model.navigation import Navigation
from station.model.place_map import PlaceMap
from station.places.joining.match import match_navigation
from station.places.joining.match_result import MatchResult
from station.places.making.build import build_map
from station.places.making.clusters import centre_and_normalise
from station.places.making.config import PlacesConfig
from station.places.registration.result import finite, registration_json


@dataclass(frozen=True, slots=True)
class Story:
    """What a report says of an experiment beside its figures."""

    title: str = "Experiment"
    setting: tuple[str, ...] = ()  # sentences: what stands in for what
    thesis: dict[str, str] = field(default_factory=dict)  # the thesis' figures by our names for them


@dataclass(frozen=True, slots=True, eq=False)
class Experiment:
    """Everything that came out."""

    story: Story
    place_map: PlaceMap
    navigation: Navigation
    result: MatchResult
    judgement: MatchJudgement | None  # None without truth
    config: PlacesConfig
    seed: int
    seconds: dict[str, float]
    not_judged: str = ""  # why there is no judgement, where there is none
    truths: tuple[Truth | None, Truth | None] = (None, None)  # for the judge and for drawing
    as_thesis: Experiment | None = None  # the same data as the thesis ran it, to stand beside this

    def found_again(self, place_id: str) -> bool | None:
        """Whether a match was accepted for this place; None where nothing could be matched at all."""
        if not self.result.registration.accepted:
            return None
        return any(match.place_id == place_id for match in self.result.matches)


def run_experiment(
    first: Navigation,
    second: Navigation,
    config: PlacesConfig,
    *,
    truths: tuple[Truth | None, Truth | None] = (None, None),
    seed: int = 0,
    story: Story | None = None,
    say: Callable[[str], None] = lambda _: None,
) -> Experiment:
    """Build, match, judge. Truth is only shown to the judge."""
    seconds: dict[str, float] = {}
    say("clustering Navigation1 into places")
    start = time.perf_counter()
    place_map = build_map(first, config=config, name="Navigation1")
    seconds["build_map"] = time.perf_counter() - start
    say("matching Navigation2 with them")
    start = time.perf_counter()
    result = match_navigation(place_map, second, config, seed=seed)
    seconds["match"] = time.perf_counter() - start
    judgement, not_judged = judge(place_map, second, truths, result)
    return Experiment(story or Story(), place_map, second, result, judgement, config, seed, seconds, not_judged, truths)


def judge(
    place_map: PlaceMap, second: Navigation, truths: tuple[Truth | None, Truth | None], result: MatchResult
) -> tuple[MatchJudgement | None, str]:
    """What truth says of the matches; without enough of it nothing, and a sentence why."""
    if truths[0] is None or truths[1] is None:
        lacking = [str(number) for number, truth in enumerate(truths, start=1) if truth is None]
        return None, f"not judged: no true poses of navigation {' and '.join(lacking)}"
    try:
        return judge_matches(place_map, truths[0], second, truths[1], result), ""
    except DataError as exc:
        return None, f"not judged: {exc}"


def normalised_rmse(experiment: Experiment) -> float | None:
    """RMSE of the registration where the map's cloud fills the unit ball: the thesis' unit of clouds without metres.

    None where nothing was registered.
    """
    rmse = experiment.result.registration.rmse
    p_world = experiment.place_map.navigation.landmarks.p_world
    p_world = p_world[np.isfinite(p_world).all(axis=1)]
    if not np.isfinite(rmse) or not len(p_world):
        return None
    if registers_normalised(experiment):
        return float(rmse)
    return float(rmse) / centre_and_normalise(p_world)[2]


def registers_normalised(experiment: Experiment) -> bool:
    """Whether the clouds were normalised before they were registered: only the thesis' method does that."""
    if experiment.config.mode != "thesis":
        return False
    asked = experiment.config.thesis.normalise
    both_metric = experiment.place_map.navigation.is_metric and experiment.navigation.is_metric
    return not both_metric if asked is None else asked


def results_dict(experiment: Experiment) -> dict[str, Any]:
    """`results.json` (CONTRACT: Files written), with more beside it."""
    place_map, result, judgement = experiment.place_map, experiment.result, experiment.judgement
    correct = {j.match.place_id: j for j in judgement.judged} if judgement else {}
    place_name = {p.id: p.name for p in place_map.places}
    location_name = {p.id: p.name for p in result.locations}
    return {
        "places": len(place_map.places),
        "locations": len(result.locations),
        "registration": {
            **registration_json(result.registration),
            "rmse_normalised": normalised_rmse(experiment),
            "error_m": None if judgement is None else judgement.registration_error,
        },
        "matches": [
            {
                "place": place_name[match.place_id],
                "location": location_name[match.location_id],
                "distance": match.distance,
                "correct": correct[match.place_id].correct if match.place_id in correct else None,
                "support": match.support,
                "true_distance_m": finite(correct[match.place_id].true_distance) if match.place_id in correct else None,
                "half_extent_m": finite(correct[match.place_id].half_extent) if match.place_id in correct else None,
            }
            for match in result.matches
        ],
        "refused": [
            {"place": place_name[m.place_id], "location": location_name[m.location_id], "reason": reason}
            for m, reason in result.refused
        ],
        "precision": judgement.precision if judgement else None,
        "recall": judgement.recall if judgement else None,
        "truth": "groundtruth" if judgement else "none",
        "not_judged": experiment.not_judged or None,
        "co_visible": [place_name[i] for i in judgement.co_visible] if judgement else None,
        "adjusted_rand_index": judgement.rand_index if judgement else None,
        "duplicate_places": judgement.duplicates if judgement else None,
        "mode": experiment.config.mode,
        "seed": experiment.seed,
        "seconds": experiment.seconds,
        "config": place_map.config,
        "as_thesis": None if experiment.as_thesis is None else results_dict(experiment.as_thesis),
    }
