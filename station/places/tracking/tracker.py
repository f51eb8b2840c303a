"""Which place, from raw data: localiser, odometry, hijack detector and estimator wired together.

Main path of the live answer: `on_imu`, `on_drive` as they come, `on_frame` for as many images as there is time for
(two a second suffice), `answer` at any moment. Pure: no clock, no thread.
"""

from __future__ import annotations

from collections.abc import Sequence

from shared.calibration import Calibration
from shared.geometry import FloatArray
from station.model.best_camera import why_unsure_of
from station.model.calibration_fit import CalibrationFit, why_unsure
from station.model.frames import DriveSample, ImageFrame, ImuBatch
from station.model.place_answer import HijackEvent, PlaceAnswer
from station.model.place_map import PlaceMap
from station.motion.dead_reckoning import DeadReckoning
from station.motion.head import AHEAD
from station.places.localisation.localizer import Attempt, Localizer
from station.places.localisation.make_index import make_index
from station.places.tracking.config import BeliefConfig
from station.places.tracking.current import CurrentPlaceEstimator
from station.places.tracking.hijack import HijackDetector
from station.places.tracking.odometry import BlendedOdometry
from station.places.tracking.servos import ServoLearner

ODOMETRY_EVERY_NS = 50_000_000


class PlaceTracker:
    """Everything between sensor data and `PlaceAnswer`. Not thread-safe: one per worker."""

    def __init__(
        self,
        maps: Sequence[PlaceMap],
        calibration: Calibration,
        localizer: Localizer | None = None,
        config: BeliefConfig | None = None,
    ) -> None:
        """`localizer`: one that was made for these maps, to save describing their keyframes again."""
        self._calibration = calibration
        self.localizer = localizer or Localizer(maps, index=[make_index(one) for one in maps])
        self.estimator = CurrentPlaceEstimator(maps, calibration, config, tried=self.localizer.tried)
        self.hijacks = HijackDetector(has_wheels=calibration.has_wheels)
        self._reckoning = DeadReckoning()
        self._servos = ServoLearner(calibration.head, self.estimator.config)
        self._blended = BlendedOdometry()
        self._odometry_t_ns: int | None = None
        self._events: list[HijackEvent] = []
        self._moved_ns: int | None = None  # when somebody moved the robot last
        self.last_attempt: Attempt | None = None
        self.last_aim = AHEAD  # of the camera then
        self._fit: CalibrationFit | None = None  # of the robot that drives now
        self._unsure_map = {m.id: why for m in maps if (why := why_unsure_of(m.navigation))}
        camera = calibration.camera
        self._shift_ns = round(camera.time_shift_s * 1e9) if camera else 0

    def on_imu(self, imu: ImuBatch) -> None:
        event = self.hijacks.on_imu(imu)
        if event is not None:
            self._on_hijack(event)
        if not self._calibration.has_wheels:
            return  # neither speed nor level floor: between images only SLAM knows how it moves
        self._reckoning.add_imu(imu)
        t, last = self._reckoning.t_robot_ns, self._odometry_t_ns
        if t is not None and (last is None or t - last >= ODOMETRY_EVERY_NS):
            self._odometry(t, self._blended.add_reckoned(t, self._reckoning.T_nav_body))

    def on_drive(self, drive: DriveSample) -> None:
        self.hijacks.on_drive(drive)
        self._reckoning.add_drive(drive)
        self._servos.on_drive(drive)

    def on_odometry(self, t_robot_ns: int, T_nav_body: FloatArray, segment: int = 0) -> None:
        """A pose of a running SLAM in metres, however late: better than dead reckoning up to its time."""
        blended = self._blended.add_slam(t_robot_ns, T_nav_body, segment)
        if self._odometry_t_ns is None or t_robot_ns > self._odometry_t_ns + ODOMETRY_EVERY_NS:  # no IMU reckons
            self._odometry(t_robot_ns, blended)

    def on_frame(self, frame: ImageFrame) -> Attempt | None:
        """Localise one image; None while the robot is carried, and for one from before that, which came late.

        Raises DataError for an undecodable image.
        """
        t = frame.t_robot_ns + self._shift_ns
        if self.hijacks.is_carried or (self._moved_ns is not None and t < self._moved_ns):
            return None
        attempt = self.localizer.attempt(frame, self._calibration, self._fit)
        self.last_attempt = attempt
        aim = self.last_aim = self._servos.aim(t)
        seen = self.hijacks.on_view(t, attempt.features, aim) if attempt.features is not None else None
        if seen is not None:
            self._on_hijack(seen)
        if not attempt.candidates:
            self.estimator.on_failure(t, attempt.num_features, aim)
            return attempt
        jump = self.estimator.on_candidates(attempt.candidates, t, aim)
        if self.estimator.sure_view is not None:
            self._servos.learn(self.estimator.sure_view)
        event = None if jump is None else self.hijacks.on_jump(t, jump.distance_m, jump.is_other_map, jump.moved)
        if event is not None:
            self._events.append(event)  # the estimate is there already
        return attempt

    def answer(self, t_robot_ns: int) -> PlaceAnswer:
        """The current place at this time (robot clock); no place or room with a calibration that nobody corrects."""
        answer = self.estimator.answer(t_robot_ns)
        why = why_unsure(self._fit)
        if not why and (of_map := self._unsure_map.get(answer.map_id or "")):
            why = f"of the navigation that the map was made from, {of_map}"
        return answer.withheld(why) if why else answer

    def on_calibration_fit(self, fit: CalibrationFit | None) -> None:
        """Whether the calibration explains what this robot measures, as far as its SLAM knows."""
        self._fit = fit

    def take_events(self) -> list[HijackEvent]:
        """Hijacks noticed since the last call."""
        events, self._events = self._events, []
        return events

    def _on_hijack(self, event: HijackEvent) -> None:
        self._events.append(event)
        self._moved_ns = event.t_robot_ns
        self.estimator.on_hijack(event.t_robot_ns, event.reason, event.confidence)

    def _odometry(self, t: int, T_nav_body: FloatArray) -> None:
        self._odometry_t_ns = t
        self.estimator.on_odometry(t, T_nav_body, self._blended.segment)
