"""The simulated flat, the robot body in it, its camera and IMU."""
