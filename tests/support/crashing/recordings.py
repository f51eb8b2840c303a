"""Recording drives for the crash tests, as the station does, and what must be in the files after."""

from __future__ import annotations

import functools
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from shared.calibration import REFERENCE_ROBOT
from shared.errors import DataError
from shared.messages import CameraFrame, Capabilities, Hello, ImuBatch, ImuSample
from station.datasets import open_dataset
from station.library.navigation_records import NavigationLibrary, NavigationRecord
from station.recordings.recorder import Recorder
from station.recordings.recovery import recover_recording
from tests.support.crashing.child import Child, Scenario
from tests.support.datasets import frames_of, imu_of

MAX_LOST_S = 5.0
IMU_HZ, FPS = 225, 20
DRIVE_S = 2.5  # then it is ended properly, and the next one begins
HELLO = Hello(
    protocol=2,
    robot_id="r",
    name="R",
    session_id="s",
    capabilities=Capabilities(camera=True, imu=True, drive=True, pan_tilt=False, battery=False, hijack=False),
    calibration=REFERENCE_ROBOT,
)
PICTURE = np.random.default_rng(0).bytes(40_000)


def record_on(folder: Path, child: Child) -> None:
    """A robot of 20 frames and 225 samples a second, in real time: drive after drive, kept as the station keeps them.

    Promised is the navigation and the time of what was handed over; "closed" when it was ended properly; "ended" when
    the recorder had to end it itself, and said why.
    """
    library = NavigationLibrary(folder / "drives")
    child.do(library.open)
    for number in range(10_000):
        navigation = NavigationRecord(f"nav-{number}", f"D{number}", "recording", time.time(), "sfm")
        recorder = child.do(functools.partial(begin_on_some_disk, library, navigation, child))
        record_one(recorder, number, child)
        report = recorder.close()
        if report.error:
            child.refused(report.error)
            child.promise([navigation.id, "ended", 0])
        else:
            child.promise([navigation.id, "closed", 0])
        ended = replace(navigation, state="failed", message=report.error or "ended")
        child.do(functools.partial(library.store, ended))


def begin_on_some_disk(library: NavigationLibrary, navigation: NavigationRecord, child: Child) -> Recorder:
    """`begin`, asking for room or not, another time at each try."""
    return begin(library, navigation, child.rng.choice((0, 2 * 2**20)))


def begin(library: NavigationLibrary, navigation: NavigationRecord, min_free_bytes: int) -> Recorder:
    """As the station begins a navigation (recording.py): one that cannot be recorded never was."""
    recorder: Recorder | None = None
    try:
        recorder = Recorder(library.recording(navigation.id), min_free_bytes=min_free_bytes)
        library.store(navigation)
    except DataError:
        if recorder is not None:
            recorder.close()
        library.discard(navigation.id)
        raise
    recorder.on_connected(HELLO)
    return recorder


def record_one(recorder: Recorder, navigation: int, child: Child) -> None:
    begin_s = time.monotonic()
    samples = 0
    for number in range(round(DRIVE_S * FPS)):
        t_ns = round(number * 1e9 / FPS)
        until = round((number + 1) * IMU_HZ / FPS)
        batch = tuple(
            ImuSample(round(n * 1e9 / IMU_HZ), (0.0, 0.0, 0.0), (0.0, 0.0, 9.81)) for n in range(samples, until)
        )
        recorder.on_imu(ImuBatch(first_sequence=samples, samples=batch))
        samples = until
        jpeg = PICTURE + (1000 * navigation + number).to_bytes(4, "big")
        frame = CameraFrame(seq=number, t_robot_ns=t_ns, exposure_ns=0, width=640, height=480, skipped=0, jpeg=jpeg)
        recorder.on_frame(frame, time.monotonic_ns())
        if recorder.error:
            return
        child.promise([f"nav-{navigation}", "taken", t_ns])
        time.sleep(max(0.0, begin_s + (number + 1) / FPS - time.monotonic()))


def look_at_recordings(folder: Path, promises: list[object]) -> str:
    """As the station starts: the library opens, what was cut is recovered; all that was promised is read."""
    library = NavigationLibrary(folder / "drives")
    for interrupted in library.open():
        path = library.recording(interrupted.id)
        if path.is_file() and path.stat().st_size:
            try:
                recover_recording(path)
            except DataError as exc:
                if "nothing that can be recovered" not in str(exc):
                    raise AssertionError(str(exc)) from exc
    taken, ends = last_taken(promises)
    known = {navigation.id for navigation in library.list()}
    worst_s = 0.0
    for navigation_id in sorted({*taken, *ends}):
        assert navigation_id in known, f"{navigation_id} is not known any more"
        worst_s = max(
            worst_s, lost_s(library.recording(navigation_id), int(navigation_id.split("-")[1]), taken[navigation_id])
        )
        assert worst_s <= MAX_LOST_S, f"{worst_s:.1f} s of {navigation_id} are lost"
        if ends.get(navigation_id) == "closed":
            assert worst_s == 0.0 or navigation_id not in taken, f"{navigation_id} was closed and lacks {worst_s:.2f} s"
    return f"{worst_s:.2f} s lost of {len(taken)} drives"


def read_recordings(folder: Path, promises: list[object]) -> None:
    """Drives that are over are read also from a disk that takes nothing; a station that runs has opened its library."""
    taken, ends = last_taken(promises)
    for navigation_id, how in ends.items():
        if how == "closed":
            lost = lost_s(
                folder / "drives" / navigation_id / "recording.mcap",
                int(navigation_id.split("-")[1]),
                taken[navigation_id],
            )
            assert lost == 0.0, f"{navigation_id} was closed and lacks {lost:.2f} s"


def write_again(folder: Path) -> None:
    """Once the disk takes writes again, a navigation is recorded and kept as ever."""
    library = NavigationLibrary(folder / "drives")
    assert not library.open(), "a navigation that was cut is told again"
    number = 1 + max((int(navigation.id.split("-")[1]) for navigation in library.list()), default=0)
    navigation = NavigationRecord(f"nav-{number}", f"D{number}", "recording", time.time(), "sfm")
    recorder = begin(library, navigation, 0)
    jpeg = PICTURE + (1000 * number).to_bytes(4, "big")
    frame = CameraFrame(seq=0, t_robot_ns=0, exposure_ns=0, width=640, height=480, skipped=0, jpeg=jpeg)
    recorder.on_frame(frame, time.monotonic_ns())
    sample = ImuSample(0, (0.0, 0.0, 0.0), (0.0, 0.0, 9.81))
    recorder.on_imu(ImuBatch(first_sequence=0, samples=(sample,)))
    assert not recorder.close().error
    assert lost_s(library.recording(navigation.id), number, 0) == 0.0
    library.store(replace(navigation, state="failed", message="ended"))
    assert not NavigationLibrary(folder / "drives").open()


def last_taken(promises: list[object]) -> tuple[dict[str, int], dict[str, str]]:
    """The last time that was handed over, by drive; and how drives ended that are over."""
    taken: dict[str, int] = {}
    ends: dict[str, str] = {}
    for promise in promises:
        assert isinstance(promise, list)
        navigation_id, what, t_ns = promise
        if what == "taken":
            taken[navigation_id] = t_ns
        else:
            ends[navigation_id] = what
    return taken, {navigation_id: how for navigation_id, how in ends.items() if navigation_id in taken}


def lost_s(path: Path, navigation: int, last_ns: int) -> float:
    """Seconds of a recording that were taken and are not in its file. AssertionError for wrong or missing parts."""
    try:
        data = open_dataset(path)
        frames = [frame.encoded for frame in frames_of(data)]
        imu = imu_of(data).t_robot_ns.tolist()
        last_read_ns = int(data.frame_times_ns[-1])
    except (DataError, IndexError):  # killed before the first second was written
        return (last_ns + 1e9 / FPS) * 1e-9
    expected = [PICTURE + (1000 * navigation + number).to_bytes(4, "big") for number in range(len(frames))]
    assert frames == expected, "a frame differs"
    assert imu == [round(n * 1e9 / IMU_HZ) for n in range(len(imu))], "a sample is missing in the middle"
    return max(0.0, (last_ns - last_read_ns) * 1e-9)


SCENARIOS = {
    "record": Scenario(lambda _: None, record_on, look_at_recordings, 6.0, read_recordings, write_again, is_timed=True)
}
