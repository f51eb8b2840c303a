"""A depth sensor in the camera's place: the renderer knows how far everything is that the camera sees."""

from __future__ import annotations

import cv2
import numpy as np

from robot.simulation.config import DepthSensorModel
from robot.simulation.renderer import Float32Array
from shared.calibration import CameraCalibration, DepthCalibration
from shared.geometry import FloatArray


def depth_calibration(camera: CameraCalibration, model: DepthSensorModel) -> DepthCalibration:
    """The camera without its distortion, with fewer pixels."""
    step = camera.width / model.columns
    first = 0.5 * (step - 1.0)
    return DepthCalibration(
        width=model.columns,
        height=max(1, round(camera.height / step)),
        fx=camera.fx / step,
        fy=camera.fy / step,
        cx=(camera.cx - first) / step,
        cy=(camera.cy - first) / step,
        T_body_depth=camera.T_body_cam,
    )


class _Cone:
    """An HC-SR04 in the camera's place: the nearest thing that sends its sound back. Lenses bend its cone by little.

    Everything sends it back, whichever way it faces, but the floor: along that, sound goes on.
    """

    EVERY = 8  # of so many pixels one is looked at: 1.5 cm at 2 m
    FLOOR_M = 0.2  # what lies so deep below the camera

    def __init__(self, camera: CameraCalibration) -> None:
        v, u = np.mgrid[0 : camera.height : self.EVERY, 0 : camera.width : self.EVERY].astype(np.float64)
        self._down = (v - camera.cy) / camera.fy
        self._way = np.sqrt(1.0 + ((u - camera.cx) / camera.fx) ** 2 + self._down**2)  # by the depth

    def nearest(self, inverse_depth: Float32Array) -> FloatArray:
        """(1,) 1/m."""
        w = inverse_depth[:: self.EVERY, :: self.EVERY].astype(np.float64)
        stands = self._down < self.FLOOR_M * w
        return np.array([np.max(w / self._way, initial=0.0, where=stands)])


class SimulatedDepth:
    """Looks up in a rendering what its pixels see."""

    def __init__(self, told: DepthCalibration, built: CameraCalibration, model: DepthSensorModel, seed: int) -> None:
        """`built`: the camera as it is, whose rendering is looked at."""
        self._model = model
        self._rng = np.random.default_rng([seed, 16])
        v, u = np.mgrid[0 : told.height, 0 : told.width].astype(np.float64)
        rays = np.stack([(u - told.cx) / told.fx, (v - told.cy) / told.fy, np.ones_like(u)], axis=-1).reshape(-1, 3)
        project = cv2.fisheye.projectPoints if built.model == "equidistant" else cv2.projectPoints
        points = rays[:, None, :] if project is cv2.projectPoints else rays[None, :, :]
        pixels = np.asarray(project(points, np.zeros(3), np.zeros(3), built.K, np.array(built.distortion))[0])
        x, y = np.round(pixels.reshape(-1, 2)).astype(np.int64).T
        self._inside = (x >= 0) & (y >= 0) & (x < built.width) & (y < built.height)
        self._at = y.clip(0, built.height - 1), x.clip(0, built.width - 1)
        self._shape = told.height, told.width
        self._cone = _Cone(built) if told.is_cone else None

    def measure(self, inverse_depth: Float32Array) -> bytes:
        """A PNG of 16 bit grey, mm. inverse_depth (H, W): of the camera's rendering, 1/m, 0 where nothing is seen."""
        if self._cone is None:
            w = np.where(self._inside, inverse_depth[self._at], 0.0).astype(np.float64)
        else:
            w = self._cone.nearest(inverse_depth)
        sees = w > 1.0 / self._model.max_m
        z = 1.0 / np.where(sees, w, 1.0) * (1.0 + self._model.noise * self._rng.standard_normal(len(w)))
        millimetres = np.where(sees, np.round(1000.0 * z), 0.0).clip(0, 65534).astype(np.uint16)
        ok, png = cv2.imencode(".png", millimetres.reshape(self._shape))
        assert ok
        return png.tobytes()
