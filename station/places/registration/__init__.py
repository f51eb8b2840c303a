"""Registration: how one point cloud lies in another's frame, with scale, or a reasoned no."""

from station.places.registration.free_space import Rays
from station.places.registration.register import register_clouds
from station.places.registration.result import Alternative, Registration, Uncertainty, uncertainty_of

__all__ = ["Alternative", "Rays", "Registration", "Uncertainty", "register_clouds", "uncertainty_of"]
