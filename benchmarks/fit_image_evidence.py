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
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from benchmarks.drive_cache import load, stored
from shared.calibration import Calibration
from shared.disk import replace_file
from station.places.tracking.config import BeliefConfig
from station.places.tracking.fitted import GENERATED, FailureOdds, FittedOdds, RecognisedOdds
from station.places.tracking.image_evidence import ImageEvidence
from station.places.tracking.map_view import MapView
from tests.support.drives.judging import where_taken
from tests.support.drives.recorded import LookedAt, generator_of
from tests.support.likelihood_fit import (
    RIGHT_M,
    Fit,
    fitted_failing,
    fitted_right,
    fitted_unmapped,
    or_usual,
    usual_of,
    with_previous,
)


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


def rows_of(cache: Path, kinds: Sequence[str]) -> tuple[list[dict[str, Any]], list[str]]:
    """Images of all stored drives of these kinds that no hand held, and the worlds they are of."""
    rows, worlds = [], []
    for path in stored(cache):
        world = load(path)
        if world.kind not in kinds or world.place_map is None:
            continue
        if world.quality is not None and world.quality.error_m > RIGHT_M / 2:
            print(f"{path.name}: left out, the map is too bent to say which pose is right", file=sys.stderr, flush=True)
            continue
        worlds.append(f"{world.kind} {world.name} {world.misfit}".strip())
        view = MapView.of(world.place_map)
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
    return rows, worlds


def fit(rows: list[dict[str, Any]], worlds: list[str], made_by: str) -> FittedOdds:
    """All regressions over these images."""
    usual = usual_of(rows)
    rows = [or_usual(row, usual) for row in rows]
    fits: dict[str, Fit] = {
        "right": fitted_right(rows),
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
        unmapped=RecognisedOdds(*numbers["unmapped"]),
        fails_at_pose=FailureOdds(*numbers["fails_at_pose"]),
        fails_in_map=FailureOdds(*numbers["fails_in_map"]),
        fails_unmapped=FailureOdds(*numbers["fails_unmapped"]),
    )


def without(kind: str) -> Path:
    """The file of what the other kinds of worlds say."""
    return Path(__file__).with_name("fitted_without") / f"{kind}.json"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cache", type=Path, required=True, help="of make_drives")
    parser.add_argument("--kinds", default="home,plain,real", help="with commas between")
    a = parser.parse_args()
    rows, worlds = rows_of(a.cache, a.kinds.split(","))
    rows = with_previous(rows)
    made_by = f"python -m benchmarks.fit_image_evidence --kinds {a.kinds}"
    fits = {GENERATED: fit(rows, worlds, made_by)}
    for kind in sorted({row["kind"] for row in rows}):
        others = [name for name in worlds if generator_of(name.split()[0]) != kind]
        fits[without(kind)] = fit([row for row in rows if row["kind"] != kind], others, f"{made_by}, without {kind}")
    for path, fitted in fits.items():
        path.parent.mkdir(exist_ok=True)
        replace_file(path, msgspec.json.format(msgspec.json.encode(fitted), indent=1) + b"\n")
    print(GENERATED.read_text())


if __name__ == "__main__":
    main()
