"""pycolmap, with the process' own way to end restored.

Importing pycolmap installs handlers that print a stack trace on SIGTERM, the signal every orderly stop uses.
"""

from __future__ import annotations

import signal
import threading

import pycolmap

if threading.current_thread() is threading.main_thread():  # only there may handlers be set
    signal.signal(signal.SIGTERM, signal.getsignal(signal.SIGTERM) or signal.SIG_DFL)

# COLMAP puts the centre of the first pixel at (0.5, 0.5); ours is at (0, 0).
COLMAP_PIXEL_CENTRE = 0.5

__all__ = ["COLMAP_PIXEL_CENTRE", "pycolmap"]
