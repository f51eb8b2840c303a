"""What the figures of an experiment are drawn from: both navigations in axes whose z is up."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shared.geometry import FloatArray, transform
from station.datasets import Truth
from station.experiments.alignment import align_points
from station.experiments.experiment import Experiment
from station.experiments.matches import true_cameras
from station.experiments.plotting import COLOURS
from station.model.navigation import Navigation
from station.places.making.scale import ground_rotation


@dataclass(frozen=True, slots=True, eq=False)
class DrivenPath:
    """Where one navigation went, in axes whose z is up."""

    position: FloatArray  # (N, 3), at least one row
    unit: str
    source: str  # where it is known from
    is_shared_frame: bool  # the other navigation's path is in the same frame


class Scene:
    """Clouds and clusters of both navigations in axes whose z is up, and their colours."""

    def __init__(self, experiment: Experiment) -> None:
        self.experiment = experiment
        self.first, self.second = experiment.place_map.navigation, experiment.navigation
        self.places, self.locations = experiment.place_map.places, experiment.result.locations
        self.place_of = {place.id: place for place in self.places}
        self.location_of = {location.id: location for location in self.locations}
        self.R_first, self.R_second = ground_rotation(self.first), ground_rotation(self.second)
        self.T = experiment.result.registration.T_target_source
        self.unit = unit_of(self.first)
        self.p_first = self.first.landmarks.p_world @ self.R_first.T
        self.p_second = self.second.landmarks.p_world @ self.R_second.T
        self.place_colour = {p.id: COLOURS[k % len(COLOURS)] for k, p in enumerate(self.places)}
        matched = {m.location_id: self.place_colour[m.place_id] for m in experiment.result.matches}
        # A location without a match keeps a colour of its own, from the other end of the list.
        spare = [c for c in reversed(COLOURS) if c not in matched.values()] or list(COLOURS)
        self.location_colour = {
            p.id: matched.get(p.id, spare[k % len(spare)]) for k, p in enumerate(self.locations)
        }  # fmt: skip
        judgement = experiment.judgement
        self.correct = {j.match.place_id: j.correct for j in judgement.judged} if judgement else {}

    def carried(self, p: FloatArray) -> FloatArray:
        """Points of Navigation2's frame in the drawn axes of the map."""
        assert self.T is not None
        return transform(self.T, p) @ self.R_first.T

    def driven_paths(self) -> tuple[DrivenPath, DrivenPath] | None:
        """Where both navigations went: by true poses where the judge had them, else as estimated; None without poses.

        True positions are turned into the drawn axes of the map and begin at Navigation1's start.
        """
        if not len(self.first.trajectory) or not len(self.second.trajectory):
            return None
        first, second = self.experiment.truths
        if self.experiment.judgement is None or first is None or second is None:
            return self._estimated_paths()
        p_first, p_second = _positions_during(self.first, first), _positions_during(self.second, second)
        if not len(p_first) or not len(p_second):
            return self._estimated_paths()
        known = true_cameras(self.first, first)[:, :3, 3]
        ok = np.isfinite(known[:, 0])
        centres = self.first.keyframes.T_world_cam[ok, :3, 3]
        R = self.R_first @ align_points(centres, known[ok], "sim3").R_target_source
        return (
            DrivenPath((p_first - p_first[0]) @ R.T, "m", "by true poses", True),
            DrivenPath((p_second - p_first[0]) @ R.T, "m", "by true poses", True),
        )

    def _estimated_paths(self) -> tuple[DrivenPath, DrivenPath]:
        p_first = self.first.trajectory.T_world_body[:, :3, 3] @ self.R_first.T
        p_second = self.second.trajectory.T_world_body[:, :3, 3]
        if self.T is not None:
            carried = DrivenPath(self.carried(p_second), self.unit, "as estimated", True)
            return DrivenPath(p_first, self.unit, "as estimated", True), carried
        own = DrivenPath(p_second @ self.R_second.T, unit_of(self.second), "as estimated", False)
        return DrivenPath(p_first, self.unit, "as estimated", False), own


def unit_of(navigation: Navigation) -> str:
    """What lengths of a navigation's own frame are in."""
    return "m" if navigation.is_metric else "map units"


def _positions_during(navigation: Navigation, truth: Truth) -> FloatArray:
    """(N, 3) true positions while the navigation was recorded, in the truth's world."""
    begin, end = navigation.trajectory.t_robot_ns[[0, -1]]
    return truth.T_world_body[(truth.t_robot_ns >= begin) & (truth.t_robot_ns <= end), :3, 3]
