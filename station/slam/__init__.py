"""SLAM: frames and IMU in, a navigation out. `backend.py` is the interface; `sfm/` and `ukf/` implement it."""
