"""Which files of station/places/ one camera frame passes through until it is an answer, and how often it comes back.

A robot circles in a made-up room with the map of an earlier drive; one of its images goes through
`PlaceTracker.on_frame` and `answer` under a tracer. Every pair of functions (caller, callee) counts once, when it is
called for the first time, and leads to the file of the callee. A visit is a stay in one file; one in a file that was
left before is a return. Vision and geometry outside of station/places/ are not counted.
`python scripts/visits.py [--calls]`: with --calls also what is called during each visit.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from types import FrameType

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

from station.model.frames import ImageFrame  # noqa: E402  (found by the line above)
from station.places.making.build import build_map  # noqa: E402
from station.places.tracking.tracker import PlaceTracker  # noqa: E402
from tests.support.synthetic_home import drive, furnished_room, navigate  # noqa: E402

ROOM = ROOT / "station" / "places"
TRACED = 21  # the image that is followed: by then the robot is known, and the view is another one than the last
Visit = tuple[str, list[str]]  # file, and the functions that are called there


class Tracer:
    """First calls of functions inside station/places/, in their order."""

    def __init__(self) -> None:
        self.calls: list[tuple[str, str]] = []  # file, function
        self._pairs: set[tuple[object, object]] = set()

    def trace(self, work: Callable[[], None]) -> None:
        sys.setprofile(self._on_event)
        try:
            work()
        finally:
            sys.setprofile(None)

    def _on_event(self, frame: FrameType, event: str, _: object) -> None:
        path = Path(frame.f_code.co_filename)
        if event != "call" or not path.is_relative_to(ROOM):
            return
        pair = (frame.f_back.f_code if frame.f_back else None, frame.f_code)
        if pair not in self._pairs:
            self._pairs.add(pair)
            self.calls.append((str(path.relative_to(ROOM)), frame.f_code.co_qualname))


def follow_one_frame() -> list[tuple[str, str]]:
    """(file, function) of every first call on the way of one recognised image to an answer."""
    room = furnished_room(seed=3)
    T_world_cam = drive(room, seed=1)
    navigation = navigate(room, T_world_cam, seed=1, seen_share=1.0, outlier_share=0.0)
    camera = navigation.calibration.camera
    assert camera is not None
    tracker = PlaceTracker([build_map(navigation)], navigation.calibration)

    def show(k: int) -> str:
        t = int(navigation.keyframes.t_robot_ns[k])
        tracker.on_frame(ImageFrame(k, t, 0, navigation.keyframes.encoded[k]))
        return tracker.answer(t).state

    for k in range(TRACED + 1):
        tracker.on_odometry(int(navigation.keyframes.t_robot_ns[k]), T_world_cam[k] @ camera.T_cam_body_matrix)
        if k < TRACED:
            show(k)
    tracer = Tracer()
    states: list[str] = []
    tracer.trace(lambda: states.append(show(TRACED)))
    if states != ["known"]:
        raise SystemExit(f"the image that is followed was not recognised: {states[0]}")
    return tracer.calls


def visits_of(calls: list[tuple[str, str]]) -> list[Visit]:
    """The calls by stays in one file."""
    visits: list[Visit] = []
    for file, function in calls:
        if not visits or visits[-1][0] != file:
            visits.append((file, []))
        visits[-1][1].append(function)
    return visits


def main(with_calls: bool) -> None:
    visits = visits_of(follow_one_frame())
    files = {file for file, _ in visits}
    for number, (file, functions) in enumerate(visits, start=1):
        print(f"{number:3} {file}", *(functions if with_calls else ()), sep="\n      " if with_calls else "")
    print(f"visits: {len(visits)}, files: {len(files)}, returns: {len(visits) - len(files)}")


if __name__ == "__main__":
    main("--calls" in sys.argv[1:])
