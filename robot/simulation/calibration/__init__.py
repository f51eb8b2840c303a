"""Recordings that calibrate a robot, rendered with known truth: boards, hand-held motion, sensors drawn anew."""
