"""How camera and IMU sit on each other: one batch estimate over a hand-held recording before a target."""
