"""False alarms: plain driving in simulated flats, all rooms mapped, also with a covered lens, other light, a person.

    python -m benchmarks.bench_false_alarms [--kind small] [--flats 6] [--seed 250] [--drives 2] [--out FILE.json]
        [--results FILE]

Nobody touches the robot, so that every hijack event is a false alarm; what the current place says meanwhile is judged
as in `bench_current_place`, on a map that SLAM made. Conditions, each for whole drives: `plain`; `lens`, covered
for 5 s of every 20; `light`, which goes to 40 %, 160 % and back every 7 s while exposure follows; `person`, who walks
through the picture.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2

from benchmarks.result import Figure, Run, add_results_option, share
from robot.simulation.config import Faults
from robot.simulation.routes import plan_route
from station.model.frames import DriveSample, ImageFrame, ImuBatch
from station.places.localisation.localizer import Localizer
from station.places.localisation.make_index import make_index
from station.places.tracking.tracker import PlaceTracker
from tests.support.drives.judging import right_places
from tests.support.drives.misfit import Misfit
from tests.support.drives.recorded import in_map
from tests.support.drives.robot import START_NS, no_faults
from tests.support.drives.routes import Plan
from tests.support.drives.simulated import DriveOptions, MappedFlat, SimulatedFlat

IMAGE_RATE_HZ, MAX_S = 2.5, 120.0
LIGHTS = (1.0, 0.4, 1.0, 1.6)
CONDITIONS: dict[str, Callable[[float], Faults]] = {
    "plain": no_faults,
    "lens": lambda t_s: Faults(covered_lens=t_s % 20 > 15),
    "light": lambda t_s: Faults(light=LIGHTS[int(t_s / 7) % len(LIGHTS)]),
    "person": lambda _t_s: Faults(person=True),
}


def undisturbed_drive(
    flat: SimulatedFlat, mapped: MappedFlat, localizer: Localizer, condition: str, seed: int
) -> dict[str, Any]:
    """One drive to its end, at most 2 minutes; answers once per image."""
    place_map = mapped.place_map
    route = plan_route(flat.world, "second" if seed % 2 else "tour", seed)
    robot = flat.robot(Plan(condition, route, None, MAX_S), seed)
    tracker = PlaceTracker([place_map], flat.told, localizer)
    states = {"known": 0, "unknown": 0, "lost": 0}
    alarms, wrong, seconds = [], 0, 0.0
    for item in robot.sent(IMAGE_RATE_HZ, CONDITIONS[condition]):
        if isinstance(item, ImuBatch):
            tracker.on_imu(item)
        elif isinstance(item, DriveSample):
            tracker.on_drive(item)
        elif isinstance(item, ImageFrame):
            tracker.on_frame(item)
            t_ns = item.t_robot_ns + flat.shift_ns
            seconds = (t_ns - START_NS) / 1e9
            answer = tracker.answer(t_ns)
            states[answer.state] += 1
            if answer.state == "known" and answer.place is not None:
                T_world_body, _ = robot.true_at(t_ns)
                T_map_body = in_map(mapped.quality.T_world_map, T_world_body)
                wrong += answer.place.id not in right_places(place_map, T_map_body[:3, 3])
        alarms += [(round((e.t_robot_ns - START_NS) / 1e9, 1), e.cue, e.reason) for e in tracker.take_events()]
    return {"flat": flat.world.seed, "drive": seed, "condition": condition, "seconds": seconds, "alarms": alarms,
            "states": states, "wrong_known": wrong}  # fmt: skip


def summarise(drives: list[dict[str, Any]]) -> dict[str, Any]:
    summary = {}
    for condition in CONDITIONS:
        mine = [d for d in drives if d["condition"] == condition]
        known = sum(d["states"]["known"] for d in mine)
        hours = sum(d["seconds"] for d in mine) / 3600
        summary[condition] = {
            "minutes": round(60 * hours, 1),
            "alarms": sum(len(d["alarms"]) for d in mine),
            "known": known / max(1, sum(sum(d["states"].values()) for d in mine)),
            "right_when_known": 1 - sum(d["wrong_known"] for d in mine) / max(1, known),
        }
    return summary


def figures(drives: list[dict[str, Any]]) -> list[Figure]:
    """The claims; a lens, light or person in the picture counts like plain driving."""
    minutes = sum(d["seconds"] for d in drives) / 60
    known = sum(d["states"]["known"] for d in drives)
    right = known - sum(d["wrong_known"] for d in drives)
    conditions = "driving plainly, with a covered lens, changing light, a person"
    return [
        Figure(f"false hijack alarms in {minutes:.0f} minutes, {conditions}", sum(len(d["alarms"]) for d in drives)),
        share(f"right when known, {conditions}", right, known),
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kind", default="small", help="of worlds: small, home, plain")
    parser.add_argument("--flats", type=int, default=6)
    parser.add_argument("--seed", type=int, default=250)
    parser.add_argument("--drives", type=int, default=2, help="of each condition in each flat")
    parser.add_argument("--out", type=Path, default=None)
    add_results_option(parser, "false_alarms")
    a = parser.parse_args()
    run = Run.begin()
    cv2.setNumThreads(1)
    drives: list[dict[str, Any]] = []
    for seed in range(a.seed, a.seed + a.flats):
        flat = SimulatedFlat(a.kind, seed, Misfit(seed=seed), DriveOptions())
        mapped = flat.mapped()
        localizer = Localizer([mapped.place_map], index=[make_index(mapped.place_map)])
        for drive in range(1, a.drives + 1):
            for condition in CONDITIONS:
                drives.append(undisturbed_drive(flat, mapped, localizer, condition, drive))
                print(json.dumps(drives[-1]), flush=True)
    print(json.dumps(summarise(drives), indent=1))
    run.write(a.results, figures(drives))
    if a.out:
        a.out.write_text(json.dumps({"summary": summarise(drives), "drives": drives}))


if __name__ == "__main__":
    main()
