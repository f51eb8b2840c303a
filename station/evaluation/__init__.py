"""Judges: trajectory error and matches against truth. Never used by the estimation."""
