"""Settings of the estimation proper. One set serves every rig; what differs between rigs is in the calibration."""

from __future__ import annotations

from dataclasses import dataclass

from station.motion.error_coordinates import ErrorKind


@dataclass(frozen=True, slots=True)
class FilterConfig:
    """Error coordinates, sizes of state and window, noise, gates."""

    error: ErrorKind = ErrorKind.RIGHT
    use_sigma_points: bool = True  # False with RIGHT: the invariant EKF
    spread: float = 1.0  # sigma points lie that many standard deviations out
    num_landmarks: int = 30  # p, at most
    num_clones: int = 18
    keyframe_parallax_deg: float = 1.0  # the newest clone replaces its predecessor until the view moved that much
    sigma_px: float = 1.0  # of a feature; errors of one track hang together, so more than their scatter
    gate_probability: float = 0.95
    landmark_gate_probability: float = 0.99
    window_gate_slack: float = 1.0
    huber: float = 1.5
    min_track_observations: int = 4
    min_landmark_observations: int = 12  # earlier, depth is far from Gaussian
    max_track_rms: float = 3.0  # whitened; a triangulation that fits worse is an outlier
    max_window_tracks: int = 30  # per frame, longest first: bounds the time per frame
    max_new_landmarks: int = 5  # per frame
    landmark_depth_sigma: float = 0.25  # relative; a point enters the state once its depth is that well known
    window_depth_sigma: float = 1.0
