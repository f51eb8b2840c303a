"""SLAM by smoothing: keyframes and landmarks in one sparse least-squares problem, lost landmarks found again."""
