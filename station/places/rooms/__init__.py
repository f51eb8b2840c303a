"""Rooms, doors and walls out of the free space that a navigation saw."""
