"""Programs that run on the robot: `robot-server`, its devices, and the simulated robot."""
