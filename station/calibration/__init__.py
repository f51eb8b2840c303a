"""How a robot's own sensors are calibrated: targets, camera, inertial unit, how they sit on each other, wheels."""
