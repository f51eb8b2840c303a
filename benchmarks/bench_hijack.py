"""Hijack detection by IMU: simulated drives with hijacks at random moments, and plain driving for false alarms.

    python -m benchmarks.bench_hijack [--trials 100] [--plain-minutes 60] [--seed 0] [--results FILE]

Truth (when the simulator lifted the robot) only judges. Images are not rendered: the vision and position cues are
measured by `bench_current_place.py`.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Iterator

import numpy as np

from benchmarks.result import Figure, Run, add_results_option, share
from robot.simulation.body import TICK_RATE_HZ, Body
from robot.simulation.config import SimulationConfig
from robot.simulation.driver import RouteDriver
from robot.simulation.routes import plan_route
from robot.simulation.sensors import ImuModel
from robot.simulation.worlds import make_world
from shared.calibration import REFERENCE_IMU, REFERENCE_ROBOT
from station.model.frames import DriveSample, ImuBatch
from station.model.place_answer import HijackEvent
from station.places.tracking.hijack import HijackDetector

FLATS = 10
BATCH = 10
NOTICED_PERCENT = 95.0  # asked


def drive(
    world_seed: int, drive_seed: int, hijack_at_s: float | None, seconds: float
) -> Iterator[ImuBatch | DriveSample | int]:
    """What a robot senses along a tour, and when it is lifted, in ns of its clock."""
    config = SimulationConfig()
    world = make_world("home", world_seed, config)
    route = plan_route(world, "tour" if drive_seed % 2 else "mapping", drive_seed, config.body.radius_m)
    rng = np.random.default_rng([world_seed, drive_seed, 3])
    body = Body(world, config.body, (*route.points[0], route.start_yaw_rad), drive_seed)
    imu = ImuModel(REFERENCE_IMU, config.imu, REFERENCE_ROBOT.gravity, drive_seed)
    driver = RouteDriver(route)
    state = body.state()
    times, gyros, accels = [], [], []
    hijacked = False
    for tick in range(int(seconds * TICK_RATE_HZ)):
        t_ns = 1_000_000_000 + round(state.t_s * 1e9)
        m = imu.measure(state)
        times.append(t_ns)
        gyros.append(m.gyro_imu)
        accels.append(m.accel_imu)
        if len(times) == BATCH:
            yield ImuBatch(np.array(times), np.array(gyros), np.array(accels))
            times, gyros, accels = [], [], []
        if tick % 15 == 0 and state.t_s > 1.5 and not hijacked:
            command = driver.command(*body.pose, float(state.omega_body[2]))
            body.command(command.linear_m_s, command.angular_rad_s)
            yield DriveSample(t_ns, command.linear_m_s, command.angular_rad_s)
            if driver.is_done:
                driver = RouteDriver(route) if np.hypot(*(route.points[0] - body.pose[:2])) < 0.5 else driver
        if hijack_at_s is not None and not hijacked and state.t_s >= hijack_at_s:
            hijacked = True
            target = route.points[rng.integers(len(route.points))]
            body.hijack(float(target[0]), float(target[1]), float(rng.uniform(-math.pi, math.pi)))
            body.command(0.0, 0.0)
            yield t_ns
        state = body.step()


def feed(events: Iterator[ImuBatch | DriveSample | int]) -> tuple[list[HijackEvent], int | None]:
    detector, found = HijackDetector(), []
    hijack_ns: int | None = None
    for value in events:
        event = None
        if isinstance(value, ImuBatch):
            event = detector.on_imu(value)
        elif isinstance(value, DriveSample):
            detector.on_drive(value)
        else:
            hijack_ns = value
        if event is not None:
            found.append(event)
    return found, hijack_ns


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trials", type=int, default=100)
    parser.add_argument("--plain-minutes", type=float, default=60.0)
    parser.add_argument("--seed", type=int, default=0)
    add_results_option(parser, "hijack")
    a = parser.parse_args()
    run = Run.begin()
    delays, missed, early = [], [], []
    for trial in range(a.trials):
        rng = np.random.default_rng([a.seed, trial])
        at = float(rng.uniform(4, 15))
        found, hijack_ns = feed(drive(a.seed + trial % FLATS, a.seed + trial, at, at + 6.0))
        assert hijack_ns is not None
        early += [(trial, e.reason) for e in found if e.t_robot_ns < hijack_ns]
        after = [(e.t_robot_ns - hijack_ns) / 1e9 for e in found if e.t_robot_ns >= hijack_ns]
        if after and after[0] <= 2.0:
            delays.append(after[0])
        else:
            missed.append(trial)
    alarms, minutes, drive_seed = [], 0.0, 1000 + a.seed
    while minutes < a.plain_minutes:
        length = min(3.0, a.plain_minutes - minutes)
        found, _ = feed(drive(a.seed + drive_seed % FLATS, drive_seed, None, 60 * length))
        alarms += [(drive_seed, e.reason) for e in found]
        minutes += length
        drive_seed += 1
    result = {
        "trials": a.trials,
        "noticed_within_2s": len(delays) / max(a.trials, 1),
        "delay_median_s": float(np.median(delays)) if delays else None,
        "delay_max_s": max(delays, default=None),
        "missed_trials": missed,
        "alarms_before_hijack": early,
        "plain_minutes": minutes,
        "false_alarms": alarms,
        "false_alarms_per_hour": len(alarms) / max(minutes / 60, 1e-9),
        "seed": a.seed,
    }
    print(json.dumps(result, indent=1))
    longest = max(delays, default=None)
    run.write(
        a.results,
        [
            share("hijack noticed within 2 s, by the IMU alone", len(delays), a.trials, at_least=NOTICED_PERCENT),
            Figure("hijack noticed, by the IMU alone: longest delay", longest, "s", of=len(delays)),
            Figure(
                f"false alarms in {minutes:.0f} minutes of plain driving, by the IMU alone", len(alarms) + len(early)
            ),
        ],
    )


if __name__ == "__main__":
    main()
