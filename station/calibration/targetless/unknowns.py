"""Everything that the estimate finds: motion at the images, corners of the scene, the calibration, gravity, biases.

A corner lies at `anchor + ray / inverse_depth` in the world, with the anchor where the camera that saw it first was
thought to be: then kept, so that corners at any distance are as good as linear.
Source: Civera, Davison and Montiel, IEEE T-RO 24(5), 2008.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from shared.calibration import CameraCalibration
from shared.geometry import FloatArray, IntArray, skew, so3_exp
from station.calibration.camera_imu.unknowns import BIASES, GRAVITY, bias_weights, moved_camera

STATE = 9  # unknowns of an image: rotation on the right, position, velocity
POINT = 3  # of a corner: ray across itself, inverse depth
MAX_INVERSE_DEPTH = 20.0  # 1/m


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """World: any origin, axes of the first image's body."""

    camera: CameraCalibration
    gravity: FloatArray  # (3,) m/s^2, world: points down
    biases: FloatArray  # (nodes, 6) rad/s, m/s^2
    t_s: FloatArray  # (K,) IMU clock: when the middle row of each image was exposed
    R: FloatArray  # (K, 3, 3) R_world_body
    p: FloatArray  # (K, 3) m
    v: FloatArray  # (K, 3) m/s
    anchor: FloatArray  # (L, 3) m, world
    ray: FloatArray  # (L, 3) unit, world
    inverse_depth: FloatArray  # (L,) 1/m

    @property
    def size(self) -> int:
        """Unknowns but for the corners': states, then the border."""
        return STATE * len(self.t_s) + self.border

    @property
    def border(self) -> int:
        return BIASES + self.biases.size

    def bias_weights(self, t_s: FloatArray) -> tuple[IntArray, FloatArray]:
        """Node before each time (N,), and the share (N, 2) of it and the next."""
        return bias_weights(t_s - self.t_s[0], len(self.biases))

    def bias_at(self, t_s: FloatArray) -> FloatArray:
        """(N, 6)."""
        node, share = self.bias_weights(t_s)
        return np.asarray(share[:, :1] * self.biases[node] + share[:, 1:] * self.biases[node + 1])

    def moved(self, states: FloatArray, border: FloatArray, points: FloatArray) -> Estimate:
        """After a step of the states (K, STATE), of the border and of the corners (L, POINT), at unchanged times."""
        ray = self.ray + (across(self.ray) @ points[:, :2, None])[..., 0]
        ray /= np.linalg.norm(ray, axis=1)[:, None]
        return replace(
            self,
            camera=moved_camera(self.camera, border),
            gravity=self.gravity + border[GRAVITY],
            biases=self.biases + border[BIASES:].reshape(-1, 6),
            R=self.R @ so3_exp(states[:, :3]),
            p=self.p + states[:, 3:6],
            v=self.v + states[:, 6:],
            ray=ray,
            inverse_depth=np.clip(self.inverse_depth + points[:, 2], 0.0, MAX_INVERSE_DEPTH),
        )

    def of_corners(self, kept: IntArray) -> Estimate:
        """With these corners alone."""
        return replace(self, anchor=self.anchor[kept], ray=self.ray[kept], inverse_depth=self.inverse_depth[kept])


def across(ray: FloatArray) -> FloatArray:
    """(L, 3, 2): two unit vectors across each ray."""
    least = np.eye(3)[np.argmin(np.abs(ray), axis=1)]
    first = np.cross(ray, least)
    first /= np.linalg.norm(first, axis=1)[:, None]
    return np.stack([first, (skew(ray) @ first[..., None])[..., 0]], axis=2)
