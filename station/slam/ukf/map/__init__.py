"""Keyframes, poses and landmarks that the filter leaves behind, and how they are refined when the drive has ended."""
