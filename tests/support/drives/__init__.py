"""Recorded drives with truth: a map that SLAM made, other drives through the same world, where each image was taken.

`simulated` and `real` make them, `playback` runs the tracker over one again, `judging` counts what it answered.
"""
