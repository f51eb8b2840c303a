"""Keyframes and landmarks that the filter leaves behind."""
