"""Repeatability of places on made-up rooms: two drives each, default and thesis mode, and what other lengths change.

    python -m benchmarks.places [--seeds 30] [--first 0] [--mode MODE ...] [--results FILE]

Clouds are synthetic (tests/support/synthetic_home.py): no images, no SLAM; registration is by clouds alone, any yaw.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from benchmarks.result import Figure, Run, add_results_option, share
from shared.geometry import se3, yaw_rotation
from station.datasets import Truth
from station.experiments.matches import MatchJudgement, judge_matches
from station.model.navigation import Navigation
from station.model.place_map import Place, PlaceMap
from station.places.joining.match import match_navigation
from station.places.joining.match_result import MatchResult
from station.places.making.build import build_map
from station.places.making.config import PlacesConfig, ThesisConfig
from tests.support.days import truth_of
from tests.support.synthetic_home import drive, furnished_room, navigate

FRAMES = 70
VARIANTS = {
    "default": PlacesConfig(),
    "eps x 0.5": PlacesConfig(eps_factor=0.5),
    "eps x 1.5": PlacesConfig(eps_factor=1.5),
    "size x 0.67": PlacesConfig(size_factor=0.67),
    "size x 1.5": PlacesConfig(size_factor=1.5),
    "thesis eps 0.3 m, MinPts 11": PlacesConfig(mode="thesis", thesis=ThesisConfig()),
    "thesis eps 0.15 m, MinPts 11": PlacesConfig(mode="thesis", thesis=ThesisConfig(eps=0.15)),
}


class Matched(Protocol):
    """A map and what was matched with it."""

    @property
    def place_map(self) -> PlaceMap: ...
    @property
    def result(self) -> MatchResult: ...


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """One room in one configuration."""

    place_map: PlaceMap
    result: MatchResult
    judgement: MatchJudgement
    seconds: float


def make_pair(seed: int) -> tuple[tuple[Navigation, Truth], tuple[Navigation, Truth]]:
    """Two drives through one room: other places to stand, other landmarks found, another frame."""
    rng = np.random.default_rng(10_000 + seed)
    size = (float(rng.uniform(3.5, 6.5)), float(rng.uniform(3.0, 5.0)))
    home = furnished_room(seed, pieces=int(rng.integers(5, 11)), size=size, density=int(rng.integers(150, 700)))
    drives = []
    for number in (1, 2):
        poses = drive(home, 10 * seed + number, frames=FRAMES, turns=float(rng.uniform(1, 2.5)),
                      radius=float(rng.uniform(0.4, 1.0)))  # fmt: skip
        T = np.eye(4) if number == 1 else se3(yaw_rotation(rng.uniform(0, 2 * np.pi)), rng.uniform(-3, 3, 3))
        navigation = navigate(home, poses, seed=10 * seed + number, T_nav_world=T, images=False, noise_m=0.02)
        drives.append((navigation, truth_of(poses)))
    return drives[0], drives[1]


def run(pair: tuple[tuple[Navigation, Truth], tuple[Navigation, Truth]], config: PlacesConfig) -> Outcome:
    (first, truth1), (second, truth2) = pair
    start = time.perf_counter()
    place_map = build_map(first, config=config)
    result = match_navigation(place_map, second, config)
    seconds = time.perf_counter() - start
    return Outcome(place_map, result, judge_matches(place_map, truth1, second, truth2, result), seconds)


def changed_share(base: Matched, other: Matched) -> float | None:
    """Share of the base's matches that the other does not have: same place and same location by their landmarks."""
    if not base.result.matches:
        return None
    kept = 0
    theirs = [_clusters(other, match.place_id, match.location_id) for match in other.result.matches]
    for match in base.result.matches:
        place, location = _clusters(base, match.place_id, match.location_id)
        kept += any(_overlap(place, p) >= 0.5 and _overlap(location, q) >= 0.5 for p, q in theirs)
    return 1 - kept / len(base.result.matches)


def _clusters(outcome: Matched, place_id: str, location_id: str) -> tuple[Place, Place]:
    place = next(p for p in outcome.place_map.places if p.id == place_id)
    return place, next(p for p in outcome.result.locations if p.id == location_id)


def _overlap(a: Place, b: Place) -> float:
    shared = len(np.intersect1d(a.landmark_index, b.landmark_index))
    return shared / (len(a.landmark_index) + len(b.landmark_index) - shared)


def summarise(outcomes: list[Outcome], changes: list[float]) -> dict[str, float | int | None]:
    judged = [j for o in outcomes for j in o.judgement.judged]
    found = sum((o.judgement.recall or 0.0) * len(o.judgement.co_visible) for o in outcomes)
    co_visible = sum(len(o.judgement.co_visible) for o in outcomes)
    rand = [o.judgement.rand_index for o in outcomes if o.judgement.rand_index is not None]
    places = sum(len(o.place_map.places) for o in outcomes)
    return {
        "accepted": sum(o.result.registration.accepted for o in outcomes),
        "places": places / len(outcomes),
        "matches": len(judged),
        "precision": float(np.mean([j.correct for j in judged])) if judged else None,
        "recall": found / co_visible if co_visible else None,
        "rand_index_median": float(np.median(rand)) if rand else None,
        "duplicate_places": sum(o.judgement.duplicates for o in outcomes) / max(places, 1),
        "changed_matches": float(np.mean(changes)) if changes else None,
        "seconds_median": float(np.median([o.seconds for o in outcomes])),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=30)
    parser.add_argument("--first", type=int, default=0, help="seed of the first room")
    parser.add_argument("--mode", nargs="*", default=list(VARIANTS), choices=list(VARIANTS), help="beside the default")
    add_results_option(parser, "places")
    arguments = parser.parse_args()
    started = Run.begin()
    names = [name for name in VARIANTS if name == "default" or name in arguments.mode]
    outcomes: dict[str, list[Outcome]] = {name: [] for name in names}
    changes: dict[str, list[float]] = {name: [] for name in names}
    for seed in range(arguments.first, arguments.first + arguments.seeds):
        pair = make_pair(seed)
        for name in names:
            outcomes[name].append(run(pair, VARIANTS[name]))
            share = changed_share(outcomes["default"][-1], outcomes[name][-1])
            if share is not None and name != "default":
                changes[name].append(share)
        told = ", ".join(f"{name}: {1 - changes[name][-1]:.2f} kept" for name in names if changes[name])
        print(f"room {seed}: {len(outcomes['default'][-1].result.matches)} matches; {told}", file=sys.stderr)
    table = {name: summarise(outcomes[name], changes[name]) for name in names}
    keys = list(next(iter(table.values())))
    print("| mode | " + " | ".join(keys) + " |")
    print("|" + " --- |" * (len(keys) + 1))
    for name, row in table.items():
        cells = ("–" if v is None else f"{v:.3g}" for v in row.values())
        print(f"| {name} | " + " | ".join(cells) + " |")
    started.write(arguments.results, figures(outcomes, changes))


def figures(outcomes: dict[str, list[Outcome]], changes: dict[str, list[float]]) -> list[Figure]:
    """What is asked of the default mode, what a wrong length changes, and the thesis' method beside it."""
    found = []
    for name, title in (("default", "made-up rooms"), ("thesis eps 0.3 m, MinPts 11", "made-up rooms, thesis mode")):
        mine = outcomes.get(name, [])
        judged = [j.correct for o in mine for j in o.judgement.judged]
        co_visible = sum(len(o.judgement.co_visible) for o in mine)
        seen = sum((o.judgement.recall or 0.0) * len(o.judgement.co_visible) for o in mine)
        if mine:
            found.append(share(f"{title}: matches that are right", sum(judged), len(judged)))
            found.append(share(f"{title}: co-visible places found", seen, co_visible))
    rand = [o.judgement.rand_index for o in outcomes["default"] if o.judgement.rand_index is not None]
    if rand:
        median = float(np.median(rand))
        found.append(Figure("made-up rooms: adjusted Rand index, median", median, at_least=0.8, of=len(rand)))
    for name in ("eps x 0.5", "eps x 1.5"):
        if changes.get(name):
            percent = 100 * float(np.mean(changes[name]))
            found.append(
                Figure(f"made-up rooms: matches that change with {name}", percent, "%", 10, of=len(changes[name]))
            )
    return found


if __name__ == "__main__":
    main()
