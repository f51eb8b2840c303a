"""What the process that talks to robots and pages imports: nothing that computes."""

from __future__ import annotations

import subprocess
import sys

LIBRARIES = (
    "scipy",
    "sklearn",
    "pycolmap",
    "small_gicp",
    "kiss_matcher",
    "open3d",
    "matplotlib",
    "threadpoolctl",
    "evo",
)
ROOMS = ("station.slam", "station.vision", "station.motion", "station.datasets", "station.experiments")
PLACES = ("registration", "localisation.localizer", "localisation.map_index", "joining", "tracking")
LOOK = """
import sys
import station.api.server  # and with it station.app
from station.workers.library_interface import LIBRARY
from station.workers.place_interface import PLACES
from station.workers.slam_interface import SLAM
unwanted = {unwanted} | {{program.module for program in (LIBRARY, PLACES, SLAM)}}
print(*sorted(name for name in sys.modules if any(name == one or name.startswith(one + ".") for one in unwanted)))
"""


def test_the_process_that_talks_imports_neither_programs_of_workers_nor_their_libraries() -> None:
    # OpenCV and NetworkX stay: a person's changes to places, and their pictures, are made in threads of the station.
    unwanted = {*LIBRARIES, *ROOMS, *(f"station.places.{name}" for name in PLACES)}
    look = LOOK.format(unwanted=unwanted)
    seen = subprocess.run([sys.executable, "-c", look], capture_output=True, text=True, check=True)
    assert seen.stdout.split() == []
