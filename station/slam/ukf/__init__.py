"""Visual-inertial SLAM: the unscented Kalman filter on Lie groups (docs/slam.md)."""
