"""Lengths that homes have, of which all that looks for rooms is made. Metres."""

from __future__ import annotations

WALL_M = 0.1  # the thickness of a thin one: nothing finer parts rooms
THICK_M = 0.35  # a wall at most, and errors of both its faces
DOOR_M = 0.7, 1.1  # the clear width of doors
OPENING_M = 1.3, 2.4  # ... and of double doors, and of openings between two rooms without any
FLOOR_PERCENT = 2.0  # of the landmarks lie lower than the floor: false ones
SKIRTING_M = 0.08  # landmarks below belong to the floor
