"""Rigid motions, inertial samples and dead reckoning."""
