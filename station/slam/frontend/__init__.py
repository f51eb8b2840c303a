"""Image front end of the online SLAM: lens, corners, optical flow, two-view outlier test."""
