"""What workers need and takes seconds to import: loaded once, by the server process that all workers are forked from.

Importing is all that may happen here. A library that started threads now would leave its locks to children without
them (tests/unit/station/workers/test_preload.py looks).
"""

from __future__ import annotations

import contextlib
import importlib

from shared.long_lived import keep_for_good
from station.workers.calibration_interface import WATCHER
from station.workers.library_interface import LIBRARY
from station.workers.place_interface import PLACES
from station.workers.slam_interface import SLAM

PROGRAMS = (SLAM.module, PLACES.module, LIBRARY.module, WATCHER.module)
# some need libraries that a machine may lack
BACKENDS = (
    "station.slam.sfm.backend",
    "station.slam.ukf.backend",
    "station.slam.mono.backend",
    "station.slam.smoothing.backend",
)
MAIN = ("shared.command_line",)  # and with it Typer: multiprocessing imports station.main in every child

for _name in (*PROGRAMS, *BACKENDS, *MAIN):
    with contextlib.suppress(ImportError):  # who needs it says what is missing
        importlib.import_module(_name)
keep_for_good()
