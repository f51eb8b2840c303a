"""How camera and IMU sit on each other, without a target: from what an ordinary lively recording shows."""
