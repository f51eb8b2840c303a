"""Recorded drives looked at anew: what the present localiser finds in the features that their images had.

    python -m benchmarks.relook CACHE --version 8
    python -m benchmarks.relook CACHE --version 8 --worlds 'plain-60*'

For a change of how images are looked for, and of nothing before it: features, maps and drives stay as they were
recorded, so that what the change does is seen alone, and in two minutes a world. The files of the former version stay.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

from threadpoolctl import threadpool_limits

from benchmarks.drive_cache import VERSION, load, store
from station.model.calibration_fit import CalibrationFit
from station.places.localisation.localizer import Localizer
from station.places.localisation.make_index import make_index
from tests.support.drives.recorded import LookedAt, RecordedDrive, RecordedWorld, SlamFit


def looked_at_again(world: RecordedWorld) -> RecordedWorld:
    if world.place_map is None:
        return world
    index = make_index(world.place_map)
    localizer = Localizer([world.place_map], index=[index])
    return replace(world, drives=tuple(_again(drive, localizer) for drive in world.drives), tried=index.tried)


def _again(drive: RecordedDrive, localizer: Localizer) -> RecordedDrive:
    fit, events = None, []
    for event in drive.events:
        if isinstance(event, SlamFit):
            fit = event.fit
        events.append(_looked_at(event, drive, localizer, fit) if isinstance(event, LookedAt) else event)
    return replace(drive, events=tuple(events))


def _looked_at(event: LookedAt, drive: RecordedDrive, localizer: Localizer, fit: CalibrationFit | None) -> LookedAt:
    features, camera = event.attempt.features, drive.calibration.camera
    if features is None or camera is None:
        return event
    return replace(event, attempt=localizer.attempt_features([features], event.t_robot_ns, camera, fit))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("cache", type=Path)
    parser.add_argument("--version", type=int, required=True, help="of the files to look at")
    parser.add_argument("--worlds", default="*", help="which of them, as a shell's pattern")
    a = parser.parse_args()
    former = f"-v{a.version}.pickle.gz"
    with threadpool_limits(limits=1):
        for path in sorted(a.cache.glob(f"{a.worlds}{former}")):
            out = path.with_name(path.name.removesuffix(former) + f"-v{VERSION}.pickle.gz")
            if not out.exists():
                store(looked_at_again(load(path)), out)
                print(out.name, flush=True)


if __name__ == "__main__":
    main()
