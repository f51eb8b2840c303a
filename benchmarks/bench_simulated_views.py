"""Can a visual front end live on the simulated pictures? Corners per view, tracking, agreement with the true motion.

    python -m benchmarks.bench_simulated_views [--world small] [--seeds 10] [--pairs 40] [--results FILE]

Per seed: pairs of frames 50 ms apart along the mapping route, all imperfections on. A corner counts when its smaller
eigenvalue (5x5, OpenCV's scale) is at least 4e-4; on the real kitchen (7-Scenes) nearly all of 300 corners are.
Forward-backward: share of corners that pyramidal LK tracks there and back within 1 px, as tracked and with the flow of
the true rotation as a start. Epipolar: distance of tracked corners from the epipolar line of the true motion with time
shift and rolling shutter as in the calibration.
"""

from __future__ import annotations

import argparse
import json

import cv2
import numpy as np

from benchmarks.bench_renderer import drive
from benchmarks.result import Figure, Run, add_results_option
from robot.simulation.atlas import default_cache_dir
from robot.simulation.config import SimulationConfig
from robot.simulation.imaging import SimulatedCamera
from robot.simulation.recording import simulated_calibration
from robot.simulation.renderer import Renderer, undistort
from robot.simulation.worlds import make_world
from shared.geometry import inverse, skew
from tests.support.corners import strong_corners

FRAME_S = 0.05
LK_WINDOW_PX, LK_LEVELS = (21, 21), 4


def measure(world: str, seed: int, pairs: int) -> dict[str, float]:
    """Figures of one drive."""
    config = SimulationConfig()
    calibration = simulated_calibration(config).camera
    assert calibration is not None
    c = calibration
    path, duration_s = drive(world, seed)
    flat = make_world(world, seed)
    renderer = Renderer(flat, c, default_cache_dir())
    is_plain = np.array([s.texture.kind == "plain_wall" for s in flat.surfaces] + [False])
    camera = SimulatedCamera(renderer, c, config.camera, seed)
    strong, plain, tracked, epipolar, flows = [], [], [], [], []
    for t in np.linspace(1.0, duration_s - 1.0, pairs):
        first, second = (
            cv2.cvtColor(camera.expose(path.pose, float(s), config.faults).image, cv2.COLOR_BGR2GRAY)
            for s in (t, t + FRAME_S)
        )
        p, count = strong_corners(np.asarray(first, dtype=np.uint8))
        strong.append(count)
        surface = renderer.render((path.pose(float(t)) @ c.T_body_cam_matrix)[None]).surface
        plain.append(float(is_plain[np.minimum(surface, len(flat.surfaces))].mean()))
        if strong[-1] < 30:
            continue
        q, found, _ = cv2.calcOpticalFlowPyrLK(
            first, second, p, np.empty_like(p), winSize=LK_WINDOW_PX, maxLevel=LK_LEVELS
        )
        r, found_back, _ = cv2.calcOpticalFlowPyrLK(
            second, first, q, np.empty_like(q), winSize=LK_WINDOW_PX, maxLevel=LK_LEVELS
        )
        good = (found[:, 0] > 0) & (found_back[:, 0] > 0) & (np.linalg.norm(r - p, axis=2)[:, 0] < 1.0)
        tracked.append(float(good.mean()))
        if not good.any():
            continue
        flows.append(float(np.median(np.linalg.norm((q - p)[good], axis=2))))
        for u, v in zip(p[good, 0].astype(float), q[good, 0].astype(float), strict=True):
            T0 = path.pose(t + c.line_delay_s * u[1]) @ c.T_body_cam_matrix
            T1 = path.pose(t + FRAME_S + c.line_delay_s * v[1]) @ c.T_body_cam_matrix
            T = inverse(T1) @ T0
            x0, x1 = (np.array([*undistort(c, (w - (c.cx, c.cy)) / (c.fx, c.fy)), 1.0]) for w in (u, v))
            E = skew(T[:3, 3]) @ T[:3, :3]
            line1, line0 = E @ x0, E.T @ x1
            epipolar.append(c.fx * abs(x1 @ line1) / np.sqrt(line1[:2] @ line1[:2] + line0[:2] @ line0[:2]))
    return {
        "seed": seed,
        "drive_s": round(duration_s, 1),
        "strong_corners_median": float(np.median(strong)),
        "views_with_100": round(float(np.mean(np.array(strong) >= 100)), 3),
        "views_with_100_away_from_the_plain_wall": round(
            float(np.mean(np.array(strong)[np.array(plain) < 0.3] >= 100)), 3
        ),
        "forward_backward_median": round(float(np.median(tracked)), 3),
        "forward_backward_p10": round(float(np.percentile(tracked, 10)), 3),
        "flow_px_median": round(float(np.median(flows)), 1),
        "epipolar_px_median": round(float(np.median(epipolar)), 3),
        "epipolar_px_p90": round(float(np.percentile(epipolar, 90)), 3),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--world", default="small")
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--pairs", type=int, default=40)
    add_results_option(parser, "simulated_views")
    arguments = parser.parse_args()
    run = Run.begin()
    cv2.setNumThreads(1)
    rows = []
    for seed in range(arguments.seeds):
        rows.append(measure(arguments.world, seed, arguments.pairs))
        print(json.dumps({"world": arguments.world, **rows[-1]}), flush=True)

    def median(key: str) -> float:
        return float(np.median([row[key] for row in rows]))

    views = 100 * median("views_with_100")
    tracked = 100 * median("forward_backward_median")
    flats = f"median of {len(rows)} flats"
    run.write(
        arguments.results,
        [
            Figure(f"simulated views with 100 corners and more, {flats}", views, "%", of=arguments.pairs * len(rows)),
            Figure(f"corners in a median view, world {arguments.world}, {flats}", median("strong_corners_median"), ""),
            Figure(f"corners tracked there and back within 1 px, {flats}", tracked, "%"),
            Figure(f"tracks against the true motion, epipolar distance, {flats}", median("epipolar_px_median"), "px"),
        ],
    )


if __name__ == "__main__":
    main()
