"""Measure the rates behind the current place (`places/tracking/config.py`), and print them as it takes them.

    python -m benchmarks.fit_place_likelihoods --cache DIR [--kinds home,small,lookalike]

Reads the drives that `make_drives` stored: what the localiser made of every image, on maps that SLAM made, beside the
truth: which pose was right, how many landmarks should have been in view, whether the room is mapped. Then fits logistic
regressions and says their log loss with each world left out in turn. None of these worlds may be used to judge the
result.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.drive_cache import load, stored
from shared.calibration import Calibration
from shared.geometry import FloatArray
from station.places.tracking.image_model import support
from station.places.tracking.map_view import MapView
from tests.support.drives.judging import where_taken
from tests.support.drives.recorded import LookedAt
from tests.support.likelihood_fit import (
    each_left_out,
    failing,
    logistic,
    minimised,
    recognising,
    right_pose_losses,
    with_previous,
)

FRESH = 0.7  # of what makes an image independent of the last one


def image_row(image: LookedAt, view: MapView, calibration: Calibration, where: dict[str, Any]) -> dict[str, Any]:
    """What one image showed, and what was true. Lengths are metres, as the map's unit says."""
    camera, T_map_body = calibration.camera, image.T_map_body
    assert camera is not None and T_map_body is not None
    true_p = T_map_body[:3, 3]
    return {
        **where,
        "p": [float(v) / view.unit for v in true_p],
        "heading": float(np.arctan2(T_map_body[1, 0], T_map_body[0, 0])),
        "features": image.attempt.num_features,
        "in_view": view.sightings.in_view(T_map_body @ camera.T_body_cam_matrix, camera),
        "poses": [
            {
                "error_m": float(np.linalg.norm((z.T_map_cam @ camera.T_cam_body_matrix)[:3, 3] - true_p)) / view.unit,
                "extent": z.extent / view.unit,
                "inliers": z.num_inliers,
                "support": support(
                    view.sightings.in_usual_views(len(z.landmarks)), view.sightings.in_view(z.T_map_cam, camera)
                ),
            }
            for z in image.attempt.candidates
        ],
    }


def rows_of(cache: Path, kinds: Sequence[str]) -> list[dict[str, Any]]:
    """Images of all stored drives of these kinds that no hand held."""
    rows = []
    for path in stored(cache):
        world = load(path)
        if world.kind not in kinds or world.place_map is None:
            continue
        view = MapView.of(world.place_map)
        for drive in world.drives:
            put_down_ns = drive.hijack.put_down_ns if drive.hijack else np.inf
            for image in drive.images:
                where = where_taken(image)
                if where == "hand" or image.T_map_body is None:
                    continue
                told = {"flat": path.name, "drive": drive.name, "t_s": image.t_robot_ns / 1e9}
                told["after"] = image.t_robot_ns > put_down_ns
                told |= {"mapped": where == "mapped", "doorway": where == "doorway"}
                rows.append(image_row(image, view, drive.calibration, told))
        print(f"{path.name}: {len(rows)} images so far", flush=True)
    return rows


# -- logistic regressions -------------------------------------------------------------------------------------------


def say(name: str, w: FloatArray, loss: float, count: int) -> None:
    print(f"{name:34s} {np.round(w, 2).tolist()}  log loss {loss:.4f} of {count}")


def fit_right(rows: list[dict[str, Any]]) -> None:
    mine = [r for r in rows if r["mapped"] and r["poses"]]
    for name, columns in (("extent", [0, 1]), ("extent, inliers", [0, 1, 2]), ("all", [0, 1, 2, 3, 4])):

        def fit(some: list[dict[str, Any]], columns: list[int] = columns) -> FloatArray:
            return minimised(right_pose_losses(some, columns), len(columns))

        def losses(some: list[dict[str, Any]], w: FloatArray, columns: list[int] = columns) -> FloatArray:
            return right_pose_losses(some, columns)(w)

        loss = each_left_out(mine, fit, losses)
        say(f"right ({name})", fit(mine), loss, len(mine))


def fit_unmapped(rows: list[dict[str, Any]]) -> None:
    """How much rarer an image is in an unmapped room: odds of the room given the image, against those of any image."""
    informative = [r for r in rows if not r["doorway"]]
    mine = [r for r in informative if r["poses"]]
    anyhow = np.log(sum(not r["mapped"] for r in informative) / sum(r["mapped"] for r in informative))

    def table(some: list[dict[str, Any]]) -> tuple[FloatArray, FloatArray]:
        X = np.array([recognising(max(r["poses"], key=lambda p: p["inliers"]), r["features"]) for r in some])
        return X, np.array([float(not r["mapped"]) for r in some])

    def losses(some: list[dict[str, Any]], w: FloatArray) -> FloatArray:
        X, y = table(some)
        return np.asarray(np.logaddexp(0, -(2 * y - 1) * (X @ w)))

    w = logistic(*table(mine))
    loss = each_left_out(mine, lambda some: logistic(*table(some)), losses)
    say("unmapped", w - np.array([anyhow, 0, 0, 0, 0]), loss, len(mine))


def fit_failing(rows: list[dict[str, Any]]) -> None:
    fresh = [r for r in rows if r.get("moved", 0.0) > FRESH]
    mapped = [r for r in fresh if r["mapped"]]
    unmapped = [r for r in fresh if not r["mapped"] and not r["doorway"]]

    def failed(some: list[dict[str, Any]]) -> FloatArray:
        return np.array([float(not r["poses"]) for r in some])

    for name, mine, columns in (
        ("fails at a pose (features, again, view)", mapped, "fav"),
        ("fails in a map (features, again)", mapped, "fa"),
        ("fails unmapped (features, again)", unmapped, "fa"),
    ):

        def losses(some: list[dict[str, Any]], w: FloatArray, columns: str = columns) -> FloatArray:
            return np.asarray(np.logaddexp(0, -(2 * failed(some) - 1) * (failing(some, columns) @ w)))

        def fit(some: list[dict[str, Any]], columns: str = columns) -> FloatArray:
            return logistic(failing(some, columns), failed(some))

        say(name, fit(mine), each_left_out(mine, fit, losses), len(mine))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cache", type=Path, required=True, help="of make_drives")
    parser.add_argument("--kinds", default="home,small,lookalike", help="with commas between")
    a = parser.parse_args()
    rows = with_previous(rows_of(a.cache, a.kinds.split(",")))
    fit_right(rows)
    fit_unmapped(rows)
    fit_failing(rows)


if __name__ == "__main__":
    main()
