"""Poses, odometry and hijacks to the current place."""
