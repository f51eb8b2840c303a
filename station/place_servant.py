"""What runs in the localisation worker process."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from shared.calibration import Calibration
from shared.errors import DataError, EstimationError
from shared.geometry import FloatArray
from station.frames import DriveSample, ImageFrame, ImuBatch
from station.kept_index import index_of
from station.maps.map import Place, PlaceEdge, PlaceMap
from station.maps.store import MapStore, StoreAddress
from station.place_report import HijackNotice, MapReading, PlaceReport
from station.places.changes import shown
from station.places.localizer import Localizer
from station.places.map_index import MapIndex
from station.places.tracker import PlaceTracker

TELL_EVERY = 4  # pictures of the map
WAITING = "another robot's localisation is looking at the pictures of the map; this one shares what it finds"


class PlaceServant:
    """Answers pictures from one map; sends HijackNotices when the robot was picked up, MapReading while it prepares."""

    def __init__(self, emit: Callable[[HijackNotice | MapReading], None]) -> None:
        self._emit = emit
        self._place_map: PlaceMap | None = None
        self._localizer: Localizer | None = None
        self._tracker: PlaceTracker | None = None
        self._num_hijacks = 0

    def load(self, store: StoreAddress, map_id: str) -> None:
        """Read a map and its index; where no worker of this station has made that yet, make it."""
        place_map = MapStore(store).load(map_id)
        total, seen = len(place_map.navigation.keyframes), 0

        def tell() -> None:
            nonlocal seen
            seen += 1
            if seen % TELL_EVERY == 1 or seen == total:
                # The last tenth is the index of their words.
                self._emit(MapReading(0.9 * (seen - 1) / total, f"looking at picture {seen} of {total} of the map"))

        self.use(place_map, index_of(store.root, place_map, tell, lambda: self._emit(MapReading(0.0, WAITING))))

    def use(self, place_map: PlaceMap, index: MapIndex | None = None) -> None:
        """Answer from this map."""
        self._place_map = shown(place_map)
        self._localizer = Localizer(self._place_map, index=index)

    def calibrate(self, calibration: Calibration) -> None:
        """The robot that drives now; what was known of another one's position is forgotten."""
        if self._place_map is None:
            raise EstimationError("no map was given to the localisation worker; activate one")
        self._tracker = PlaceTracker(self._place_map, calibration, self._localizer)

    def regroup(self, places: tuple[Place, ...], edges: tuple[PlaceEdge, ...]) -> None:
        """The map's places are others, or have other names; what is known of the robot's pose stays."""
        if self._place_map is None:
            raise EstimationError("no map was given to the localisation worker; activate one")
        self._place_map = shown(replace(self._place_map, places=places, edges=edges))
        if self._tracker is not None:
            self._tracker.estimator.regroup(self._place_map)

    def imu(self, t_robot_ns: list[int], gyro: list[tuple[float, ...]], accel: list[tuple[float, ...]]) -> None:
        """Inertial samples, times and (N, 3) values."""
        if self._tracker is not None:
            self._tracker.on_imu(
                ImuBatch(np.array(t_robot_ns, np.int64), np.array(gyro, np.float64), np.array(accel, np.float64))
            )
            self._tell_hijacks(None)

    def drive(self, sample: DriveSample) -> None:
        """What the motors were told."""
        if self._tracker is not None:
            self._tracker.on_drive(sample)

    def odometry(self, t_robot_ns: int, T_nav_body: FloatArray, segment: int) -> None:
        """A pose of the running navigation: carries the estimate between pictures."""
        if self._tracker is not None:
            self._tracker.on_odometry(t_robot_ns, T_nav_body, segment)

    def answer(self, frame: ImageFrame) -> PlaceReport:
        """Where this picture was taken, and the current place at its time."""
        if self._place_map is None or self._tracker is None:
            raise EstimationError("no map was given to the localisation worker; activate one")
        try:
            attempt = self._tracker.on_frame(frame)
            why_not = attempt.reason if attempt else "the robot is being carried, or was since this picture"
        except DataError as exc:  # one broken picture; the next one may be whole
            attempt, why_not = None, str(exc)
        found = attempt.localization if attempt is not None else None
        report = PlaceReport(
            map_id=self._place_map.id,
            answer=self._tracker.answer(frame.t_robot_ns),
            T_map_cam=found.T_map_cam if found else None,
            t_evidence_ns=found.t_robot_ns if found else None,
            attempt=why_not,
        )
        self._tell_hijacks(report)
        return replace(report, num_hijacks=self._num_hijacks)

    def _tell_hijacks(self, report: PlaceReport | None) -> None:
        """At once, with the answer since: the next picture's may be seconds away on a busy machine."""
        assert self._place_map is not None and self._tracker is not None
        for event in self._tracker.take_events():
            self._num_hijacks += 1
            if report is None:
                answer = self._tracker.answer(event.t_robot_ns)
                since = PlaceReport(self._place_map.id, answer, None, None, event.reason, self._num_hijacks)
            else:
                since = replace(report, num_hijacks=self._num_hijacks)
            self._emit(HijackNotice(event, since))
