"""MCAP recordings: written, checked, recovered, played."""
