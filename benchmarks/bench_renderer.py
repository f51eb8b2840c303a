"""Frames per second of the simulated camera on one core, all imperfections on, along a drive through a flat.

    python -m benchmarks.bench_renderer [--world home] [--seed 1] [--frames 200] [--results FILE]

Prints one JSON object: CPU milliseconds per frame (mean, p50, p99; process time, so other programs do not count).
"""

from __future__ import annotations

import argparse
import json
import time

import cv2
import numpy as np

from benchmarks.result import Figure, Run, add_results_option
from robot.simulation.atlas import default_cache_dir
from robot.simulation.body import Body
from robot.simulation.config import SimulationConfig
from robot.simulation.driver import RouteDriver
from robot.simulation.imaging import SimulatedCamera
from robot.simulation.recording import simulated_calibration
from robot.simulation.renderer import Renderer
from robot.simulation.routes import plan_route
from robot.simulation.trajectory import MotionHistory
from robot.simulation.worlds import make_world


def drive(world_name: str, seed: int) -> tuple[MotionHistory, float]:
    """The true path of a mapping drive and its duration in s."""
    world = make_world(world_name, seed)
    route = plan_route(world, "mapping")
    body = Body(world, SimulationConfig().body, (*route.points[0], route.start_yaw_rad), seed)
    driver, states = RouteDriver(route), [body.state()]
    while not driver.is_done:
        if len(states) % 15 == 1:
            command = driver.command(*body.pose, float(states[-1].omega_body[2]))
            body.command(command.linear_m_s, command.angular_rad_s)
        states.append(body.step())
    return MotionHistory(states), states[-1].t_s


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--world", default="home")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--frames", type=int, default=200)
    add_results_option(parser, "renderer")
    arguments = parser.parse_args()
    run = Run.begin()
    cv2.setNumThreads(1)
    config = SimulationConfig()
    calibration = simulated_calibration(config).camera
    assert calibration is not None
    path, duration_s = drive(arguments.world, arguments.seed)
    began = time.process_time()
    renderer = Renderer(make_world(arguments.world, arguments.seed), calibration, default_cache_dir())
    bake_s = time.process_time() - began
    camera = SimulatedCamera(renderer, calibration, config.camera, arguments.seed)
    cpu_ms, sizes = [], []
    for t in np.linspace(0.1, duration_s - 0.1, arguments.frames):
        began = time.process_time()
        exposure = camera.expose(path.pose, float(t), config.faults)
        cpu_ms.append(1e3 * (time.process_time() - began))
        sizes.append(len(exposure.jpeg))
    p50, p99 = np.percentile(cpu_ms, [50, 99])
    print(
        json.dumps(
            {
                "world": arguments.world,
                "seed": arguments.seed,
                "frames": arguments.frames,
                "cpu_ms_mean": round(float(np.mean(cpu_ms)), 2),
                "cpu_ms_p50": round(float(p50), 2),
                "cpu_ms_p99": round(float(p99), 2),
                "fps_one_core": round(1e3 / float(np.mean(cpu_ms)), 1),
                "jpeg_kb_mean": round(float(np.mean(sizes)) / 1024, 1),
                "open_cpu_s": round(bake_s, 2),
            }
        )
    )
    run.write(
        arguments.results,
        [
            Figure("simulated camera, 640×480: CPU per frame, mean", float(np.mean(cpu_ms)), "ms", of=len(cpu_ms)),
        ],
    )


if __name__ == "__main__":
    main()
