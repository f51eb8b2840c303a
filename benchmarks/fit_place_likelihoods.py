"""Measure the rates behind the current place (`places/tracking/config.py`), and print them as it takes them.

    python -m benchmarks.fit_place_likelihoods [--rows FILE.jsonl] [--flats 101-120] [--drives 1 3]

Drives those of `bench_current_place` (its stand-in for a map, too) through development flats, tries to recognise every
image, and compares with the truth: which pose was right, how many landmarks should have been in view, whether the room
is mapped. Then fits logistic regressions and says their log loss with each flat left out in turn. `--rows` keeps what
was recognised and goes on from there. None of these flats may be used to judge the result.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.bench_current_place import (
    DOORWAY_M,
    START_NS,
    Robot,
    flat_to_drive,
    planned_hijack,
    unmapped_room,
)
from robot.simulation.config import SimulationConfig
from robot.simulation.recording import simulated_calibration
from shared.calibration import Calibration
from shared.geometry import FloatArray, inverse
from station.model.frames import ImageFrame
from station.places.localisation.localizer import Attempt
from station.places.tracking.image_model import support
from station.places.tracking.map_view import MapView
from tests.support.likelihood_fit import (
    each_left_out,
    failing,
    logistic,
    minimised,
    numbers,
    recognising,
    right_pose_losses,
    with_previous,
)

CARRIED_S = 3.0  # after hands took the robot: images until then show anything
FRESH = 0.7  # of what makes an image independent of the last one


def image_row(
    attempt: Attempt, T_world_body: FloatArray, view: MapView, calibration: Calibration, where: dict[str, Any]
) -> dict[str, Any]:
    """What one image showed, and what was true."""
    camera = calibration.camera
    assert camera is not None
    true_p = T_world_body[:3, 3]
    return {
        **where,
        "p": [float(v) for v in true_p],
        "heading": float(np.arctan2(T_world_body[1, 0], T_world_body[0, 0])),
        "features": attempt.num_features,
        "in_view": view.sightings.in_view(T_world_body @ inverse(camera.T_cam_body_matrix), camera),
        "poses": [
            {
                "error_m": float(np.linalg.norm((z.T_map_cam @ camera.T_cam_body_matrix)[:3, 3] - true_p)),
                "extent": z.extent,
                "inliers": z.num_inliers,
                "support": support(
                    view.sightings.in_usual_views(len(z.landmarks)), view.sightings.in_view(z.T_map_cam, camera)
                ),
            }
            for z in attempt.candidates
        ],
    }


def record(flats: Sequence[int], drives: Sequence[int], path: Path | None) -> list[dict[str, Any]]:
    """Rows of all drives; those in the file are not driven again."""
    calibration = simulated_calibration(SimulationConfig())
    assert calibration.camera is not None
    rows = [json.loads(line) for line in path.read_text().splitlines()] if path and path.exists() else []
    done = {(row["flat"], row["drive"]) for row in rows}
    for flat in flats:
        if all((flat, drive) in done for drive in drives):
            continue
        world, renderer, place_map, localizer = flat_to_drive("small", flat, calibration, whole=False)
        view, unmapped = MapView.of(place_map), unmapped_room(world)
        driven = place_map.navigation.keyframes.T_world_cam[:, :2, 3]
        for drive in [d for d in drives if (flat, d) not in done]:
            robot = Robot(world, renderer, calibration, "second", drive)
            hijack = planned_hijack(world, robot, unmapped, drive)
            mine = []
            for item in robot.sense(hijack.at_s + 17.0, 0.4, (hijack.at_s, hijack.target)):
                if not isinstance(item, ImageFrame):
                    continue
                t_s = (item.t_robot_ns - START_NS) / 1e9 + calibration.camera.time_shift_s
                if 0 <= t_s - hijack.at_s < CARRIED_S:
                    continue
                T = robot.history.pose(t_s)
                where = {"flat": flat, "drive": drive, "t_s": t_s, "after": t_s > hijack.at_s}
                where["mapped"] = world.room_at(*T[:2, 3]) != unmapped
                where["doorway"] = bool(
                    not where["mapped"] and np.linalg.norm(driven - T[:2, 3], axis=1).min() < DOORWAY_M
                )
                mine.append(image_row(localizer.attempt(item, calibration), T, view, calibration, where))
            rows += mine
            if path is not None:
                with path.open("a") as file:
                    file.writelines(json.dumps(row) + "\n" for row in mine)
            print(f"flat {flat}, drive {drive}: {len(mine)} images", flush=True)
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
    parser.add_argument("--flats", type=numbers, default=numbers("101-120"))
    parser.add_argument("--drives", type=int, nargs="+", default=[1, 3])
    parser.add_argument("--rows", type=Path, default=None)
    a = parser.parse_args()
    cv2.setNumThreads(1)
    rows = with_previous(record(a.flats, a.drives, a.rows))
    fit_right(rows)
    fit_unmapped(rows)
    fit_failing(rows)


if __name__ == "__main__":
    main()
