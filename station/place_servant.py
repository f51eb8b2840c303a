"""What runs in the localisation worker process."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from shared.calibration import Calibration
from shared.errors import EstimationError
from shared.geometry import FloatArray
from station.frames import ImageFrame
from station.maps.map import PlaceMap
from station.maps.store import MapStore
from station.place_report import PlaceReport
from station.places.answer import PlaceAnswer, PlaceCandidate
from station.places.current import CurrentPlaceEstimator
from station.places.localizer import Localizer


class PlaceServant:
    """Answers pictures from one map: the localiser finds them, the estimator says what that means over time."""

    def __init__(self, emit: Callable[[Any], None]) -> None:
        self._emit = emit
        self._place_map: PlaceMap | None = None
        self._localizer: Localizer | None = None
        self._estimator: CurrentPlaceEstimator | None = None
        self._calibration: Calibration | None = None
        self._names: dict[str, str] = {}  # of places renamed since the map was read
        self._report: PlaceReport | None = None

    def load(self, store: Path, map_id: str) -> None:
        """Read a map and index its pictures: some 60 ms per keyframe."""
        self._place_map = MapStore(store).load(map_id)
        self._localizer = Localizer(self._place_map)
        self._estimator = None

    def rename(self, place_id: str, name: str) -> PlaceReport | None:
        """The last answer, with the new name."""
        self._names[place_id] = name
        if self._report is not None:
            self._report = replace(self._report, answer=self._named(self._report.answer))
        return self._report

    def odometry(self, t_robot_ns: int, T_nav_body: FloatArray, segment: int) -> None:
        """A pose of the running navigation: carries the estimate between pictures."""
        if self._estimator is not None:
            self._estimator.on_odometry(t_robot_ns, T_nav_body, segment)

    def hijack(self, t_robot_ns: int, reason: str) -> None:
        """The robot was picked up."""
        if self._estimator is not None:
            self._estimator.on_hijack(t_robot_ns, reason)

    def answer(self, frame: ImageFrame, calibration: Calibration) -> PlaceReport:
        """Where this picture was taken, and the current place at its time."""
        if self._place_map is None or self._localizer is None:
            raise EstimationError("no map was given to the localisation worker; activate one")
        if self._estimator is None or calibration != self._calibration:
            self._estimator = CurrentPlaceEstimator(self._place_map, calibration)
            self._calibration = calibration
        attempt = self._localizer.attempt(frame, calibration)
        if attempt.localization is not None:
            self._estimator.on_localization(attempt.localization)
        else:
            self._estimator.on_failure(frame.t_robot_ns, attempt.num_features)
        answer = self._named(self._estimator.answer(frame.t_robot_ns))
        T_map_cam = attempt.localization.T_map_cam if attempt.localization else None
        self._report = PlaceReport(self._place_map.id, answer, T_map_cam, attempt.reason)
        return self._report

    def _named(self, answer: PlaceAnswer) -> PlaceAnswer:
        if not self._names:
            return answer

        def named(candidate: PlaceCandidate) -> PlaceCandidate:
            return replace(candidate, name=self._names.get(candidate.id, candidate.name))

        return replace(
            answer,
            place=None if answer.place is None else named(answer.place),
            alternatives=tuple(named(candidate) for candidate in answer.alternatives),
        )
