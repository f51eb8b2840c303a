"""What stays of a navigation without an IMU: poses, keyframes with their pictures, landmarks triangulated from them.

Keyframes hold their poses by time, so that poses may be mended until the end.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from shared.geometry import FloatArray, IntArray
from station.files.spill import Spill, SpilledFiles
from station.model.frames import ImageArray, ImageFrame
from station.model.navigation import Keyframes, Landmarks
from station.slam.mapping.assemble import make_keyframes
from station.slam.ukf.map.keyframes import Keyframe, sample_grey
from station.slam.ukf.map.landmark_map import LandmarkQuality, LiveMap, make_landmarks
from station.vision.camera_model import CameraModel
from station.vision.klt import TrackedFrame


class MapLog:
    def __init__(self, camera: CameraModel, quality: LandmarkQuality, keyframe_flow: float) -> None:
        """keyframe_flow: of the image's width; half of the last keyframe's features moved that much, or are gone."""
        self._camera, self._quality, self._flow_px = camera, quality, keyframe_flow * camera.lens.camera.width
        self.poses: dict[int, FloatArray] = {}  # by time of the image, ns: T_world_body
        self._keyframes: list[Keyframe] = []  # without their files
        self.encoded = SpilledFiles(Spill())  # these
        self._live = LiveMap(camera, quality)

    def add(
        self, frame: ImageFrame, grey: ImageArray, ids: IntArray, uv_px: FloatArray, segment: int
    ) -> tuple[bool, tuple[FloatArray, FloatArray] | None]:
        """Take in a frame whose pose is known, and what was seen in it.

        Returns:
            Whether it is a keyframe; points (n, 3) and colours (n, 3) of features that were seen last before it, for
            the live view.
        """
        if not self._is_keyframe(ids, uv_px, segment):
            return False, None
        tracked = TrackedFrame(ids, uv_px, self._camera.lens.unproject(uv_px), len(ids), float(grey.mean()))
        image, T, still, six = replace(frame, encoded=b""), self.poses[frame.t_robot_ns], np.zeros(3), np.zeros(6)
        rgb = sample_grey(grey, uv_px)
        self._keyframes.append(Keyframe(image, tracked, rgb, T, still, still, six, segment, None, None))
        self.encoded.append(frame.encoded)
        return True, self._live.add(self._keyframes[-1])

    def _is_keyframe(self, ids: IntArray, uv_px: FloatArray, segment: int) -> bool:
        if not self._keyframes or self._keyframes[-1].segment != segment:
            return True
        then = self._keyframes[-1].tracked
        _, now, before = np.intersect1d(ids, then.ids, assume_unique=True, return_indices=True)
        flow = np.linalg.norm(uv_px[now] - then.uv_px[before], axis=1)
        return int((flow < self._flow_px).sum()) < 0.5 * len(then.ids)

    def map(self) -> tuple[Keyframes, Landmarks]:
        """Keyframes and landmarks, by the poses as they are known now."""
        items = [replace(key, T_world_head=self.poses[key.image.t_robot_ns]) for key in self._keyframes]
        images = [replace(key.image, encoded=e) for key, e in zip(items, self.encoded, strict=True)]
        T_world_body = np.array([key.T_world_head for key in items])
        keyframes = make_keyframes(images, T_world_body @ self._camera.lens.camera.T_body_cam_matrix)
        segment = np.array([key.segment for key in items], dtype=np.int64)
        return replace(keyframes, segment=segment), make_landmarks(items, self._camera, self._quality)
