"""What workers need and takes seconds to import: loaded once, by the server process that all workers are forked from.

Importing is all that may happen here. A library that started threads now would leave its locks to children without
them (tests/unit/station/workers/test_preload.py looks).
"""

from __future__ import annotations

import contextlib
import gc
import importlib
import pkgutil

import station.commands

SERVANTS = ("station.workers.slam", "station.workers.places", "station.workers.library_jobs")
BACKENDS = ("station.slam.sfm.backend", "station.slam.ukf.backend")  # some need libraries that a machine may lack
# multiprocessing imports the main module of the program in every child: so what that imports must be there too. Not it
# itself: where it is run with `python -m` it would be there twice, and runpy warns of that.
COMMANDS = tuple(
    f"{station.commands.__name__}.{found.name}" for found in pkgutil.iter_modules(station.commands.__path__)
)

for _name in (*SERVANTS, *BACKENDS, *COMMANDS):
    with contextlib.suppress(ImportError):  # who needs it says what is missing
        importlib.import_module(_name)
gc.collect()
gc.freeze()  # a collection in a child would write to, and so copy, pages that all children share
