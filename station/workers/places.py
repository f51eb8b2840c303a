"""What runs in a localisation worker: pictures in, the current place out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from shared.calibration import Calibration
from shared.errors import DataError, EstimationError, RobotSystemError
from shared.geometry import FloatArray
from station.maps.store import MapStore
from station.model.calibration_fit import CalibrationFit
from station.model.frames import DriveSample, ImageFrame, ImuBatch
from station.model.map_store import StoreAddress
from station.model.place_answer import HijackNotice, MapLeftOut, MapReading, PlaceAnswer, PlaceReport
from station.model.place_map import Grouping, PlaceMap
from station.places.localisation.index_file import index_of
from station.places.localisation.localizer import Localizer
from station.places.localisation.make_index import make_index
from station.places.localisation.map_index import MapIndex
from station.places.making.changes import without_hidden
from station.places.tracking.tracker import PlaceTracker
from station.workers.place_interface import PlaceEvent, PlaceProgram
from station.workers.request import Vectors

REPORT_EVERY = 4  # pictures of the map
WAITING = "another robot's localisation is looking at the pictures of the map; this one shares what it finds"


class PlaceFinder(PlaceProgram):
    """Answers pictures from the active maps, of which the first is meant while nobody knows where the robot is.

    Sends HijackNotices when the robot was picked up, MapReading while it prepares, MapLeftOut for one that is damaged.
    """

    def __init__(self, emit: Callable[[PlaceEvent], None]) -> None:
        self._emit = emit
        self._maps: tuple[PlaceMap, ...] = ()
        self._localizer: Localizer | None = None
        self._tracker: PlaceTracker | None = None
        self._num_hijacks = 0

    def load(self, store: StoreAddress, map_ids: tuple[str, ...]) -> None:
        """Also makes an index where no worker of this station has made it yet."""
        maps = self._read(MapStore(store), map_ids)
        self.use(maps, [self._index_of(store, maps, number) for number in range(len(maps))])

    def _read(self, store: MapStore, map_ids: tuple[str, ...]) -> list[PlaceMap]:
        maps: list[PlaceMap] = []
        failed: dict[str, RobotSystemError] = {}
        for map_id in map_ids:
            try:
                maps.append(store.load(map_id))
            except RobotSystemError as exc:
                failed[map_id] = exc
        for map_id, why in failed.items():
            if not maps:
                raise why
            self._emit(MapLeftOut(map_id, str(why)))
        return maps

    def _index_of(self, store: StoreAddress, maps: Sequence[PlaceMap], number: int) -> MapIndex:
        place_map, sizes = maps[number], [len(one.navigation.keyframes) for one in maps]
        total, all_total, before = sizes[number], sum(sizes), sum(sizes[:number])
        which = "the map" if len(maps) == 1 else place_map.name
        seen = 0

        def count() -> None:
            nonlocal seen
            seen += 1
            if seen % REPORT_EVERY == 1 or seen == total:
                # The last tenth is the index of their words.
                fraction = 0.9 * (before + seen - 1) / all_total
                self._emit(MapReading(fraction, f"looking at picture {seen} of {total} of {which}"))

        return index_of(
            store.root, place_map, count, lambda: self._emit(MapReading(0.9 * before / max(all_total, 1), WAITING))
        )

    def use(self, maps: Sequence[PlaceMap], indexes: Sequence[MapIndex] | None = None) -> None:
        """Answer from these maps; `indexes`: of each of them, else they are made."""
        self._maps = tuple(without_hidden(place_map) for place_map in maps)
        self._localizer = Localizer(self._maps, index=indexes or [make_index(one) for one in self._maps])

    def calibrate(self, calibration: Calibration) -> None:
        if not self._maps:
            raise EstimationError("no map was given to the localisation worker; activate one")
        self._tracker = PlaceTracker(self._maps, calibration, self._localizer)

    def regroup(self, grouping: Grouping) -> None:
        if not self._maps:
            raise EstimationError("no map was given to the localisation worker; activate one")
        self._maps = tuple(
            without_hidden(grouping.applied_to(one)) if one.id == grouping.map_id else one for one in self._maps
        )
        if self._tracker is not None:
            self._tracker.estimator.regroup(self._maps)

    def add_imu(self, t_robot_ns: Sequence[int], gyro: Vectors, accel: Vectors) -> None:
        if self._tracker is not None:
            self._tracker.on_imu(
                ImuBatch(np.array(t_robot_ns, np.int64), np.array(gyro, np.float64), np.array(accel, np.float64))
            )
            self._notify_hijacks(None)

    def add_drive(self, sample: DriveSample) -> None:
        if self._tracker is not None:
            self._tracker.on_drive(sample)

    def add_pose(self, t_robot_ns: int, T_nav_body: FloatArray, segment: int) -> None:
        if self._tracker is not None:
            self._tracker.on_odometry(t_robot_ns, T_nav_body, segment)

    def use_fit(self, fit: CalibrationFit | None) -> None:
        if self._tracker is not None:
            self._tracker.on_calibration_fit(fit)

    def answer(self, frame: ImageFrame) -> PlaceReport:
        if self._tracker is None:
            raise EstimationError("no map was given to the localisation worker; activate one")
        try:
            attempt = self._tracker.on_frame(frame)
            why_not = attempt.reason if attempt else "the robot is being carried, or was since this picture"
        except DataError as exc:  # one broken picture; the next one may be whole
            attempt, why_not = None, str(exc)
        found = attempt.localization if attempt is not None else None
        answer = self._tracker.answer(frame.t_robot_ns)
        map_id = self._map_of(answer)
        report = PlaceReport(
            map_id=map_id,
            answer=answer,
            T_map_cam=found.T_map_cam if found and found.map_id == map_id else None,
            t_evidence_ns=found.t_robot_ns if found else None,
            attempt=why_not,
        )
        self._notify_hijacks(report)
        return replace(report, num_hijacks=self._num_hijacks)

    def _notify_hijacks(self, report: PlaceReport | None) -> None:
        """At once, with the answer since: the next picture's may be seconds away on a busy machine."""
        assert self._tracker is not None
        for event in self._tracker.take_events():
            self._num_hijacks += 1
            if report is None:
                answer = self._tracker.answer(event.t_robot_ns)
                since = PlaceReport(self._map_of(answer), answer, None, None, event.reason, self._num_hijacks)
            else:
                since = replace(report, num_hijacks=self._num_hijacks)
            self._emit(HijackNotice(event, since))

    def _map_of(self, answer: PlaceAnswer) -> str:
        return answer.map_id or self._maps[0].id
