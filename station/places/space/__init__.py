"""Free space that a navigation saw."""
