"""The topological map: places (nodes), bearings between them (edges), and the navigation they were clustered from."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

from shared.geometry import FloatArray, IntArray
from station.model.floor_plan import FloorPlan, NameSuggestion, PlanEdits
from station.model.navigation import Navigation

EdgeKind = Literal["seen together", "driven between", "nearest"]
ROOM_SEPARATOR = " · "  # in the name of a place that is called after its room
DOOR_TO = "door to"  # follows it, where the place is beside one of several doors, before the name of the other room
PlaceGrain = Literal["rooms", "fine"]  # a few places in each room, or every cluster of landmarks


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """A cluster of landmarks of the map (thesis 4.3.1)."""

    id: str  # stable: survives re-clustering and renaming
    name: str
    centroid_map: FloatArray  # (3,)
    radius: float  # RMS distance of its landmarks from the centroid, map units
    landmark_index: IntArray  # (n,) into map.navigation.landmarks
    keyframe_index: IntArray  # (k,) keyframes that saw its landmarks, most observations first
    representative_keyframe: int  # eq. 4.2: the image nearest to the mean image; -1 without images
    quality: float  # 0..1, how clearly its hill stands out, times how many landmarks it has
    hidden: bool = False  # by a person: never answered, not in the graph; its name is kept
    named: bool = False  # by a person: else its name says no more than its room and a number


@dataclass(frozen=True, slots=True)
class PlaceEdge:
    """Two places that are visible together or driven between."""

    a: str
    b: str
    bearing_rad: float  # direction a -> b in the map's ground plane, from +x towards +y
    distance: float  # between centroids, map units
    kind: EdgeKind


@dataclass(frozen=True, slots=True, eq=False)
class PlaceMap:
    """Places + graph + the navigation they come from. The map frame is that navigation's world frame."""

    id: str
    name: str
    navigation: Navigation
    places: tuple[Place, ...]
    edges: tuple[PlaceEdge, ...]
    config: dict[str, object]  # the effective clustering parameters
    plan: FloorPlan | None = None  # None: made before maps had plans, or of nothing that shows a floor
    plan_edits: PlanEdits = field(default_factory=PlanEdits)
    suggestions: tuple[NameSuggestion, ...] = ()  # of names for its rooms, found when it was made

    @property
    def grain(self) -> PlaceGrain:
        """What its places are; maps from before there was a choice are fine."""
        return "rooms" if self.config.get("places") == "rooms" else "fine"

    def room_of(self, place_id: str) -> str | None:
        """Id of the room that a place is in; None without a plan, and outside of its rooms."""
        return None if self.plan is None else self.plan.room_of_place.get(place_id)

    def with_grain(self, grain: PlaceGrain) -> PlaceMap:
        """The map, whose places are to be these; those of the thesis mode are its clusters and nothing else."""
        config = {key: value for key, value in self.config.items() if key != "places"}
        chosen = {"places": "rooms"} if grain == "rooms" and config.get("mode") != "thesis" else {}
        return replace(self, config=config | chosen)


@dataclass(frozen=True, slots=True, eq=False)
class Grouping:
    """What people change of a map in use: its places, their graph and its rooms."""

    map_id: str
    places: tuple[Place, ...]
    edges: tuple[PlaceEdge, ...]
    plan: FloorPlan | None

    @classmethod
    def of(cls, place_map: PlaceMap) -> Grouping:
        return cls(place_map.id, place_map.places, place_map.edges, place_map.plan)

    def applied_to(self, place_map: PlaceMap) -> PlaceMap:
        """The map with these."""
        return replace(place_map, places=self.places, edges=self.edges, plan=self.plan)
