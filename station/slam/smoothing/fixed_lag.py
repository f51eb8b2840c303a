"""The newest seconds of keyframes and landmarks, estimated together while the robot drives (GTSAM's fixed-lag ISAM2).

What leaves the window is marginalised: what it said of the rest stays as a linear prior.
Source: Kaess et al., iSAM2, IJRR 31(2), 2012; Forster et al., IEEE T-RO 33(1), 2017.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import SupportsFloat, SupportsIndex, SupportsInt

import gtsam
import numpy as np

from shared.calibration import ImuNoise
from shared.geometry import FloatArray, IntArray
from station.slam.mapping.inertial_bundle import collect_tracks
from station.slam.mapping.inertial_graph import (
    WHEELS_KEY,
    bias_key,
    inertial_factor,
    landmark_key,
    odometry_factor,
    pose_key,
    prior_factors,
    reprojection_factor,
    standstill_factors,
    to_pose,
    velocity_key,
    wheel_factor,
)
from station.slam.smoothing.config import SmoothingConfig
from station.slam.smoothing.keyframe import SmoothKeyframe, camera_pose, reprojections, views_of
from station.slam.smoothing.landmarks import LandmarkTable
from station.slam.smoothing.recall import cut_patches
from station.slam.ukf.filter.constraints import WheelsKnown
from station.vision.camera_model import CameraModel
from station.vision.triangulation import triangulate

# Rotation, position, velocity, biases. Position and yaw of a start are definitions.
SIGMA_START = np.array([0.03, 0.03, 1e-4, 1e-4, 1e-4, 1e-4, 0.2, 0.2, 0.2, *[0.01] * 3, *[0.1] * 3])
WHEEL_HUBER = 2.0
MIN_SEEN = 8  # landmarks; with fewer a keyframe takes the motion since the last one from the filter
MAX_TRIANGULATION_RMS = 2.0
MIN_POINT_SIGMA_M = 0.5
RELINEARISE_ABOVE = 0.01  # rad, m, m/s; a tenth of it was no better


class FixedLagWindow:
    """Keyframes go in, better ones come out: their states are changed in place."""

    def __init__(
        self,
        camera: CameraModel,
        noise: ImuNoise,
        gravity: float,
        config: SmoothingConfig,
        landmarks: LandmarkTable,
        wheels: WheelsKnown | None,
    ) -> None:
        self._camera, self._noise, self._gravity = camera, noise, gravity
        self._config, self.landmarks = config, landmarks
        self._wheels = wheels
        self._T_body_cam = to_pose(camera_pose(np.eye(4), camera))
        self.keyframes: list[SmoothKeyframe] = []
        self._keys: dict[int, int] = {}  # landmark number: its key's number while it is in the window
        self._next_key = 0
        self._change: _Change | None = None  # by the newest keyframe, until it is solved for
        self._smoother = self._new_smoother()

    @property
    def oldest(self) -> int:
        """Number of the keyframe with which the window begins."""
        return self.keyframes[0].number if self.keyframes else 0

    def _new_smoother(self) -> gtsam.IncrementalFixedLagSmoother:
        parameters = gtsam.ISAM2Params()
        parameters.findUnusedFactorSlots = True  # else slots, memory and time grow without end
        parameters.relinearizeSkip = 1
        parameters.setRelinearizeThreshold(RELINEARISE_ABOVE)
        return gtsam.IncrementalFixedLagSmoother(self._config.lag_s, parameters)

    def add(self, keyframe: SmoothKeyframe, grey: np.ndarray[tuple[int, int], np.dtype[np.uint8]]) -> None:
        """Take a keyframe in where it was predicted; `solve` says where it is."""
        change = _Change()
        self._add_motion(change, keyframe)
        self.keyframes.append(keyframe)
        self._add_views(change, keyframe)
        self._add_new_landmarks(change, keyframe, grey)
        self._change = change

    @property
    def is_solved(self) -> bool:
        return self._change is None

    def solve(self) -> bool:
        """Give the newest keyframe and those of the window their newest estimate.

        False where the equations have no single solution: the window begins anew with this keyframe.
        """
        change, self._change = self._change, None
        if change is None:
            return True
        try:
            self._smoother.update(change.graph, change.values, change.times)
        except RuntimeError:  # GTSAM's: the equations are indeterminate
            self._restart()
            return False
        self._forget()
        self._read()
        return True

    def _add_motion(self, change: _Change, keyframe: SmoothKeyframe) -> None:
        k, t = keyframe.number, keyframe.t_s
        change.variable(pose_key(k), to_pose(keyframe.T_world_body), t)
        change.variable(velocity_key(k), keyframe.v_world, t)
        change.variable(bias_key(k), keyframe.bias, t)
        if not self.keyframes:
            for factor in prior_factors(k, keyframe.T_world_body, keyframe.v_world, keyframe.bias, SIGMA_START):
                change.graph.push_back(factor)
        else:
            assert keyframe.link is not None
            before = self.keyframes[-1].number
            change.graph.push_back(inertial_factor(before, k, keyframe.link, self._noise, self._gravity))
            if keyframe.is_still:
                wheels = self._config.odometry.wheels
                for factor in standstill_factors(
                    before, k, wheels.sigma_still_rad, wheels.sigma_still_m, wheels.sigma_still_m_s
                ):
                    change.graph.push_back(factor)
        if self._wheels is not None:
            self._add_wheels(change, keyframe, self._wheels)

    def _add_wheels(self, change: _Change, keyframe: SmoothKeyframe, known: WheelsKnown) -> None:
        if not self.keyframes:
            change.variable(WHEELS_KEY, known.mean, keyframe.t_s)
            change.graph.push_back(
                gtsam.PriorFactorVector(WHEELS_KEY, known.mean, gtsam.noiseModel.Diagonal.Sigmas(known.sigma))
            )
        change.times[WHEELS_KEY] = keyframe.t_s
        wheels = keyframe.wheels
        if wheels is None or wheels.by_wheels is None or keyframe.is_still:
            return
        sigma = wheels.sigma / np.sqrt(max(keyframe.frames_since, 1))
        factor = wheel_factor(keyframe.number, wheels.by_wheels, sigma, WHEEL_HUBER)
        if factor is not None:
            change.graph.push_back(factor)

    def _add_views(self, change: _Change, keyframe: SmoothKeyframe) -> None:
        """What the keyframe sees of landmarks, as far as it fits."""
        table, config = self.landmarks, self._config
        rows = table.rows(keyframe.tracked.ids)
        seen = np.flatnonzero(rows >= 0)
        rows = rows[seen]
        tracked = keyframe.tracked
        xy, sigma, distance = reprojections(
            keyframe, self._camera, table.p_world[rows], tracked.uv_px[seen], tracked.xy[seen]
        )
        gate = np.where(np.isin(tracked.ids[seen], keyframe.trusted), config.gate_trusted, config.gate)
        fits = np.flatnonzero((distance < gate) & ~table.is_bad[rows])
        keyframe.is_poor = keyframe.T_before is not None and len(fits) < MIN_SEEN
        if keyframe.is_poor:
            assert keyframe.T_before is not None
            before = self.keyframes[-2].number
            change.graph.push_back(odometry_factor(before, keyframe.number, keyframe.T_before))
        for i in fits.tolist():
            row, number = int(rows[i]), int(tracked.ids[seen[i]])
            if number not in self._keys:
                self._bring_back(change, number, row, keyframe.t_s)
            change.graph.push_back(
                reprojection_factor(
                    keyframe.number, self._keys[number], xy[i], sigma[i], config.huber, self._T_body_cam
                )
            )
            change.times[landmark_key(self._keys[number])] = keyframe.t_s
            table.last_seen[row] = keyframe.number

    def _bring_back(self, change: _Change, number: int, row: int, t_s: float) -> None:
        """A landmark that had left the window enters again, where it was left."""
        table = self.landmarks
        cov = table.cov[row] + self._config.sigma_recalled_m**2 * np.eye(3)
        self._insert(change, number, table.p_world[row], t_s, cov)

    def _insert(self, change: _Change, number: int, p_world: FloatArray, t_s: float, cov: FloatArray) -> None:
        key = self._next_key
        self._next_key += 1
        self._keys[number] = key
        change.variable(landmark_key(key), p_world, t_s)
        change.graph.push_back(
            gtsam.PriorFactorPoint3(landmark_key(key), p_world, gtsam.noiseModel.Gaussian.Covariance(cov))
        )

    def _add_new_landmarks(
        self, change: _Change, keyframe: SmoothKeyframe, grey: np.ndarray[tuple[int, int], np.dtype[np.uint8]]
    ) -> None:
        """Tracks whose depth is known by now become landmarks, with all their views in the window."""
        config, table, camera = self._config, self.landmarks, self._camera
        tracks = collect_tracks([k.tracked for k in self.keyframes], config.min_views)
        fresh = tracks.seen[:, -1] & (table.rows(tracks.ids) < 0)
        if not fresh.any():
            return
        ids, uv, xy, seen = tracks.ids[fresh], tracks.uv_px[fresh], tracks.xy[fresh], tracks.seen[fresh]
        R, x = views_of(self.keyframes, camera, uv)
        points = triangulate(camera, R, x, xy, seen, 4)
        good = points.is_good & (points.rms < MAX_TRIANGULATION_RMS) & (points.depth_sigma < config.max_depth_sigma)
        last_uv = uv[:, -1]
        patches, inside = cut_patches(
            grey, last_uv[good], camera_pose(keyframe.T_world_body, camera), config.recall.stored_px
        )
        kept = np.flatnonzero(good)[inside]
        table.add(ids[kept], points.p[kept], points.cov[kept], patches, keyframe.number)
        centre = camera_pose(keyframe.T_world_body, camera)[:3, 3]
        for f in kept.tolist():
            depth = float(np.linalg.norm(points.p[f] - centre))
            weak = max(config.sigma_landmark_share * depth, MIN_POINT_SIGMA_M)
            self._insert(change, int(ids[f]), points.p[f], keyframe.t_s, weak**2 * np.eye(3))
        for k, view in enumerate(self.keyframes):
            at = kept[seen[kept, k]]
            corrected, sigma, distance = reprojections(view, camera, points.p[at], uv[at, k], xy[at, k])
            for i in np.flatnonzero(distance < config.gate).tolist():
                key = self._keys[int(ids[at[i]])]
                change.graph.push_back(
                    reprojection_factor(view.number, key, corrected[i], sigma[i], config.huber, self._T_body_cam)
                )

    def _read(self) -> None:
        """All estimates of the window."""
        values = self._smoother.calculateEstimate()
        for k in self.keyframes:
            k.T_world_body = values.atPose3(pose_key(k.number)).matrix()
            k.v_world = values.atVector(velocity_key(k.number))
            k.bias = values.atVector(bias_key(k.number))
        table = self.landmarks
        for number, key in self._keys.items():
            table.p_world[table.row(number)] = values.atPoint3(landmark_key(key))
        if self._wheels is not None:
            self._wheels = WheelsKnown(values.atVector(WHEELS_KEY), self._wheels.sigma)

    def _forget(self) -> None:
        """What the smoother has marginalised: its estimate stays as it is."""
        known = self._smoother.timestamps()
        gone = [number for number, key in self._keys.items() if landmark_key(key) not in known]
        if gone:
            self._leave(np.array(gone, dtype=np.int64))
        for number in gone:
            del self._keys[number]
        while pose_key(self.keyframes[0].number) not in known:
            self.keyframes.pop(0)

    def _leave(self, numbers: IntArray) -> None:
        """How well landmarks that leave are known, by all their views in the window."""
        table, camera = self.landmarks, self._camera
        tracks = collect_tracks([k.tracked for k in self.keyframes], 2)
        leaving = np.isin(tracks.ids, numbers)
        R, x = views_of(self.keyframes, camera, tracks.uv_px[leaving])
        points = triangulate(camera, R, x, tracks.xy[leaving], tracks.seen[leaving], 2)
        rows = table.rows(tracks.ids[leaving])
        good = points.is_good & (points.rms < 2.0 * MAX_TRIANGULATION_RMS)
        table.cov[rows[good]] = points.cov[good]
        table.is_bad[rows[~good]] = True

    def _restart(self) -> None:
        """The equations could not be solved: begin anew with the newest keyframe, as it was predicted."""
        newest = self.keyframes[-1]
        self._smoother = self._new_smoother()
        self._keys, self.keyframes = {}, []
        change = _Change()
        self._add_motion(change, newest)
        self.keyframes.append(newest)
        self._smoother.update(change.graph, change.values, change.times)


@dataclass(slots=True, eq=False)
class _Change:
    """What one keyframe adds to the problem."""

    graph: gtsam.NonlinearFactorGraph
    values: gtsam.Values
    times: dict[SupportsInt | SupportsIndex, SupportsFloat | SupportsIndex]

    def __init__(self) -> None:
        self.graph, self.values, self.times = gtsam.NonlinearFactorGraph(), gtsam.Values(), {}

    def variable(self, key: int, value: gtsam.Pose3 | FloatArray, t_s: float) -> None:
        self.values.insert(key, value)
        self.times[key] = t_s
