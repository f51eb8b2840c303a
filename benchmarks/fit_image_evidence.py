"""Fit the evidence of images (`station/places/tracking/fitted.json`) to recorded drives, and write the file.

    python -m benchmarks.fit_image_evidence --cache DIR [--kinds home,plain,real]

Reads the drives that `make_drives` stored: what the localiser made of every image, on maps that SLAM made, beside the
truth: which pose was right, how many landmarks should have been in view, whether the map knows the place. Every kind of
world counts the same, however many images there are of it. The log loss is that of each kind by what the other kinds
say, and what they say lies in `benchmarks/fitted_without/`, for `bench_current_place --leave-kind-out`. None of these
worlds may be used to judge the result.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from benchmarks.drive_cache import load, stored
from shared.calibration import Calibration
from shared.disk import replace_file
from station.places.tracking.config import BeliefConfig
from station.places.tracking.fitted import GENERATED, FailureOdds, FittedOdds, RecognisedOdds, Usual
from station.places.tracking.image_evidence import ImageEvidence
from station.places.tracking.map_view import MapView
from station.places.tracking.own_pictures import RIGHT_M, Judged, fitted_to_own, judged, own_log_odds
from tests.support.drives.judging import where_taken
from tests.support.drives.recorded import LookedAt, generator_of
from tests.support.likelihood_fit import (
    Fit,
    fitted_failing,
    fitted_right,
    fitted_unmapped,
    or_usual,
    right_pose_losses,
    usual_of,
    with_previous,
)

ROUNDS = 10


def image_row(image: LookedAt, view: MapView, calibration: Calibration, where: dict[str, Any]) -> dict[str, Any]:
    """What one image showed, and what was true. Lengths are metres, as the map's unit says."""
    camera, T_map_body = calibration.camera, image.T_map_body
    assert camera is not None
    evidence = ImageEvidence([view], calibration, BeliefConfig())
    poses = [evidence.measured(z) for z in image.attempt.candidates]
    row = {
        **where,
        "features": image.attempt.num_features,
        "poses": [{"p": m.T_map_body[:3, 3] / view.unit, "figures": evidence.figures(m)} for m in poses],
    }
    if T_map_body is None:
        return row
    true_p = T_map_body[:3, 3] / view.unit
    for pose in row["poses"]:
        pose["error_m"] = float(np.linalg.norm(pose["p"] - true_p))
    return row | {
        "p": true_p.tolist(),
        "heading": float(np.arctan2(T_map_body[1, 0], T_map_body[0, 0])),
        "in_view": view.sightings.surely_in_view(T_map_body @ camera.T_body_cam_matrix, camera),
    }


@dataclass(frozen=True, slots=True)
class OwnPictures:
    """Of one world's map, tried in it."""

    kind: str
    pictures: Sequence[Judged]


def rows_of(cache: Path, kinds: Sequence[str]) -> tuple[list[dict[str, Any]], list[str], dict[str, OwnPictures]]:
    """Images of all stored drives of these kinds that no hand held, the worlds they are of, and those' own pictures."""
    rows, worlds, own = [], [], {}
    for path in stored(cache):
        world = load(path)
        if world.kind not in kinds or world.place_map is None:
            continue
        if world.quality is not None and world.quality.error_m > RIGHT_M / 2:
            print(f"{path.name}: left out, the map is too bent to say which pose is right", file=sys.stderr, flush=True)
            continue
        worlds.append(f"{world.kind} {world.name} {world.misfit}".strip())
        view = MapView.of(world.place_map)
        own[path.name] = OwnPictures(generator_of(world.kind), judged(view, world.tried))
        for drive in world.drives:
            put_down_ns = drive.hijack.put_down_ns if drive.hijack else np.inf
            for image in drive.images:
                where = where_taken(image)
                if where == "hand":
                    continue
                told = {
                    "kind": generator_of(world.kind),
                    "world": path.name,
                    "drive": drive.name,
                    "t_s": image.t_robot_ns / 1e9,
                }
                told["after"] = image.t_robot_ns > put_down_ns
                told |= {"mapped": where == "mapped", "doorway": where == "doorway"}
                rows.append(image_row(image, view, drive.calibration, told))
        print(f"{path.name}: {len(rows)} images so far", file=sys.stderr, flush=True)
    return rows, worlds, own


def fit(rows: list[dict[str, Any]], worlds: list[str], own: dict[str, OwnPictures], made_by: str) -> FittedOdds:
    """All regressions over these images."""
    usual = usual_of(rows)
    rows = [or_usual(row, usual) for row in rows]
    right, tried = fitted_with_own(rows, own, usual)
    right = replace(right, losses=losses_by_others(rows, own, usual))
    fits: dict[str, Fit] = {
        "right": right,
        "unmapped": fitted_unmapped(rows),
        "fails_at_pose": fitted_failing(rows, mapped=True, with_view=True),
        "fails_in_map": fitted_failing(rows, mapped=True, with_view=False),
        "fails_unmapped": fitted_failing(rows, mapped=False, with_view=False),
    }
    numbers = {name: [round(float(w), 3) for w in one.w] for name, one in fits.items()}
    return FittedOdds(
        made_by=made_by,
        worlds=tuple(worlds),
        log_loss={
            f"{name}, {kind} by the others": round(loss, 4)
            for name, one in fits.items()
            for kind, loss in one.losses.items()
        },
        usual=usual,
        right=RecognisedOdds(*numbers["right"]),
        tried=round(tried, 3),
        unmapped=RecognisedOdds(*numbers["unmapped"]),
        fails_at_pose=FailureOdds(*numbers["fails_at_pose"]),
        fails_in_map=FailureOdds(*numbers["fails_in_map"]),
        fails_unmapped=FailureOdds(*numbers["fails_unmapped"]),
    )


def fitted_with_own(rows: list[dict[str, Any]], own: dict[str, OwnPictures], usual: Usual) -> tuple[Fit, float]:
    """Which pose is right, and what own pictures have in common: in turn with what each map has of its own.

    What explains own pictures has a mean of zero, every kind with the same weight: what all have in common is the
    constant's. Maps add what is below it (`own_log_odds`).
    """
    found, tried = fitted_right(rows), 0.0
    kinds = [one.kind for one in own.values()]
    weight = [1.0 / kinds.count(kind) for kind in kinds]
    for _ in range(ROUNDS):
        odds = RecognisedOdds(*found.w.tolist())
        values = [fitted_to_own(one.pictures, odds, usual, tried) for one in own.values()]
        mean = float(np.average(values, weights=weight))
        by_world = {name: min(0.0, value - mean) for name, value in zip(own, values, strict=True)}
        tried += mean
        found = fitted_right([{**row, "own": by_world[row["world"]]} for row in rows])
    return found, tried


def losses_by_others(rows: list[dict[str, Any]], own: dict[str, OwnPictures], usual: Usual) -> dict[str, float]:
    """Nats per image of each kind by what the others say, and by what its own maps' pictures say then."""
    kinds = sorted({one.kind for one in own.values()})
    losses = {}
    for kind in kinds if len(kinds) > 1 else []:
        others = {name: one for name, one in own.items() if one.kind != kind}
        found, tried = fitted_with_own([row for row in rows if row["kind"] != kind], others, usual)
        odds = RecognisedOdds(*found.w.tolist())
        theirs = {n: own_log_odds(one.pictures, odds, usual, tried) for n, one in own.items() if one.kind == kind}
        judged_rows = [row | {"own": theirs[row["world"]]} for row in rows if row["kind"] == kind]
        judged_rows = [row for row in judged_rows if row["mapped"] and row["poses"]]
        losses[kind] = float(right_pose_losses(judged_rows)(found.w).mean())
    return losses


def without(kind: str) -> Path:
    """The file of what the other kinds of worlds say."""
    return Path(__file__).with_name("fitted_without") / f"{kind}.json"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cache", type=Path, required=True, help="of make_drives")
    parser.add_argument("--kinds", default="home,plain,real", help="with commas between")
    a = parser.parse_args()
    rows, worlds, own = rows_of(a.cache, a.kinds.split(","))
    rows = with_previous(rows)
    made_by = f"python -m benchmarks.fit_image_evidence --kinds {a.kinds}"
    fits = {GENERATED: fit(rows, worlds, own, made_by)}
    for kind in sorted({row["kind"] for row in rows}):
        others = [name for name in worlds if generator_of(name.split()[0]) != kind]
        theirs = {name: one for name, one in own.items() if one.kind != kind}
        fits[without(kind)] = fit(
            [row for row in rows if row["kind"] != kind], others, theirs, f"{made_by}, without {kind}"
        )
    for path, fitted in fits.items():
        path.parent.mkdir(exist_ok=True)
        replace_file(path, msgspec.json.format(msgspec.json.encode(fitted), indent=1) + b"\n")
    print(GENERATED.read_text())


if __name__ == "__main__":
    main()
