"""What `bench_crash.py` and the tests do to recording, saving, building, renaming, merging and migrating.

A child is forked, works, and says on a pipe what it has been promised. It is killed at a random moment, or its disk
becomes full or read-only. Then the parent looks: everything promised is there, nothing is mixed, everything opens.
"""

from __future__ import annotations

import atexit
import functools
import random
import re
import shutil
import tempfile
import time
from pathlib import Path

from tests.support.crashing import maps as crash_maps
from tests.support.crashing import recordings as crash_recording
from tests.support.crashing.child import STUCK_S, Scenario, Working, start
from tests.support.crashing.disks import Disk, disk_image, failing_disk, full_disk
from tests.support.crashing.maps import DATABASE

SCENARIOS: dict[str, Scenario] = {**crash_recording.SCENARIOS, **crash_maps.SCENARIOS}
AFTER_S = 0.004  # the kill comes up to so much later than the processor time says: also into a wait for the disk
REFUSED_WITHIN_S = 5.0  # longer than anything works between two writes
WORKS_AGAIN_WITHIN_S = 120.0
NAMES_CAUSE = re.compile(
    r"No space left|is full|MiB are left|[Rr]ead-only|readonly|[Ii]nput/output error|disk I/O error"
)


def run_once(name: str, folder: Path, seed: int, database: str = "") -> str:
    """One kill. Returns what was seen, in words. Raises AssertionError, naming the loss.

    `database`: the URL of an empty PostgreSQL database for the store's index.
    """
    scenario = SCENARIOS[name]
    rng = random.Random(seed)
    shutil.rmtree(folder, ignore_errors=True)
    _prepare(name, folder, database)
    working = start(lambda child: scenario.work(folder, child), seed)
    try:
        _work(working, scenario, rng)
    finally:
        promises = working.kill()
    assert not working.refusals, f"refused on a sound disk: {working.refusals[0]}"
    return scenario.look(folder, promises)


def run_two_stations(folder: Path, seed: int, database: str = "") -> str:
    """Two stations write to one store at once; one is killed, the other goes on."""
    rng = random.Random(seed)
    shutil.rmtree(folder, ignore_errors=True)
    _prepare("rename", folder, database)
    stations = [
        start(functools.partial(crash_maps.station_on, folder, number=number), seed)
        for number in range(len(crash_maps.STATIONS))
    ]
    victim = rng.randrange(len(stations))
    promised: list[list[object]] = [[] for _ in stations]
    try:
        stations[victim].work_for(rng.uniform(0.0, 0.4), is_timed=False)
        time.sleep(rng.uniform(0.0, AFTER_S))
        promised[victim] = stations[victim].kill()
        other = stations[1 - victim]
        other.listen(0)
        before = len(other.promises)
        assert other.wait(lambda: len(other.promises) >= before + 2, STUCK_S), "the other station cannot write any more"
    finally:
        promised[1 - victim] = stations[1 - victim].kill()
    return crash_maps.look_at_stations(folder, promised)


def run_on_full_disk(name: str, seed: int) -> str:
    """The disk becomes full at a random moment. Then there is room again, and the work goes on by itself."""
    scenario, rng = SCENARIOS[name], random.Random(seed)
    with full_disk() as disk:
        _prepare(name, disk.home)
        working = start(lambda child: scenario.work(disk.home, child), seed)
        try:
            _work(working, scenario, rng)
            told = _refuse(working, scenario, disk, rng)
            disk.mend()
            before = len(working.promises)
            is_over = name == "migrate" and before == 1
            assert is_over or working.wait(lambda: len(working.promises) > before, WORKS_AGAIN_WITHIN_S), (
                f"it never worked again; the last word was: {working.refusals[-1:]}"
            )
        finally:
            promises = working.kill()
        seen = scenario.look(disk.home, promises)
        scenario.write_again(disk.home)
        return f"{seen}; {told}"


def run_on_failing_disk(name: str, seed: int) -> str:
    """The disk becomes read-only at a random moment of the work: everything is read beside the work and after its end.

    Then it is mounted again, nothing that was promised is missing, and it is written to as ever.
    """
    scenario, rng = SCENARIOS[name], random.Random(seed)
    with disk_image() as image:
        with failing_disk(image) as disk:
            _prepare(name, disk.home)
            disk.settle()
            working = start(lambda child: scenario.work(disk.home, child), seed)
            try:
                _work(working, scenario, rng)
                told = _refuse(working, scenario, disk, rng)
            finally:
                promises = working.kill()
            scenario.read(disk.home, promises)
        with failing_disk(image) as disk:
            seen = scenario.look(disk.home, promises)
            scenario.write_again(disk.home)
            return f"{seen}; {told}"


RUNS_ON_BAD_DISK = {"full": run_on_full_disk, "read-only": run_on_failing_disk}


def _work(working: Working, scenario: Scenario, rng: random.Random) -> None:
    working.work_for(rng.uniform(0.0, scenario.longest_s), is_timed=scenario.is_timed)
    time.sleep(rng.uniform(0.0, AFTER_S))


def _refuse(working: Working, scenario: Scenario, disk: Disk, rng: random.Random) -> str:
    """Let the disk refuse for a while; what was seen, in words."""
    disk.spoil()

    def is_refused() -> bool:
        disk.keep_spoilt()
        return bool(working.refusals)

    was_refused = working.wait(is_refused, REFUSED_WITHIN_S)
    promises = list(working.promises)
    scenario.read(disk.home, promises)
    end_s = time.monotonic() + rng.uniform(0.0, 0.2)
    working.wait(lambda: is_refused() and time.monotonic() > end_s, 1.0)
    for sentence in set(working.refusals):
        assert NAMES_CAUSE.search(sentence), f"this does not say what is wrong: {sentence}"
        assert "\n" not in sentence and "Traceback" not in sentence, f"this is no sentence: {sentence}"
    return (
        f"refused {len(working.refusals)} times: {working.refusals[0]}" if was_refused else "nothing was written then"
    )


def _prepare(name: str, folder: Path, database: str = "") -> None:
    folder.mkdir(parents=True, exist_ok=True)
    if database:
        (folder / DATABASE).write_text(database)
        SCENARIOS[name].prepare(folder)
    else:
        shutil.copytree(_template(name), folder, dirs_exist_ok=True)


@functools.cache
def _template(name: str) -> Path:
    folder = Path(tempfile.mkdtemp(prefix="crash-template-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    SCENARIOS[name].prepare(folder)
    return folder
