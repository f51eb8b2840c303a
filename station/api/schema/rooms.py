"""Rooms, doors and walls of the active map."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from pydantic import Field

from shared.geometry import FloatArray
from station.api.schema.base import Model, Name, Number, Question
from station.api.schema.places import PlaceName, RoomName
from station.library.active_maps import ActiveMap
from station.model.floor_plan import NameSuggestion, Room, SuggestionSource
from station.model.points import NO_PLACE
from station.places.rooms.drawing import room_outlines
from station.places.rooms.lines import driven_path
from station.places.rooms.summary import suggested

Coordinate = Annotated[Number, Field(ge=-1e6, le=1e6)]
Point = list[float]
DrawnPoint = Annotated[list[Coordinate], Field(min_length=2, max_length=2)]


class NameSuggestionModel(Model):
    """A name that something seen speaks for; PATCH /rooms/{id} uses it, nobody else does."""

    name: str = Field(examples=["Kitchen"])
    source: SuggestionSource
    confidence: float = Field(description="0..1", examples=[0.98])
    reason: str = Field(examples=['A sticker that reads "Kitchen" hangs here: one picture shows it, from 1.4 m.'])
    image: str | None = Field(description="the picture that shows it", examples=["/maps/map-0a1b/images/17.jpg"])
    corners_px: list[Point] | None = Field(description="where in that picture")


class RoomModel(Model):
    """A room of the active map."""

    id: str = Field(examples=["room-3f21aa"])
    name: str = Field(examples=["Kitchen"])
    named: bool = Field(description="a person gave it its name")
    area_m2: float | None = Field(description="null without a metric map", examples=[11.2])
    middle: Point = Field(description="x, y on the plan: a free spot far from its walls")
    doors: list[str] = Field(description="ids of the doors that lead out of it")
    places: list[PlaceName] = Field(description="its places that are not hidden")
    suggestions: list[NameSuggestionModel] = Field(description="names that something seen speaks for, the surest first")


class DoorModel(Model):
    """A passage between two rooms."""

    id: str
    rooms: list[str | None] = Field(description="the two it leads to; null: nobody went through")
    ends: list[Point] = Field(description="where its jambs are on the plan")
    width: float = Field(description="map units")
    drawn: bool = Field(description="by a person")


class PlanRoom(RoomName):
    """A room as it is drawn."""

    named: bool
    middle: Point
    outline: list[list[Point]] = Field(description="closed lines: what is inside an odd number of them is the room")


class PlanPlace(PlaceName):
    """A place as it is drawn."""

    at: Point
    room: str | None
    colour: int
    representative_image: str | None


class FloorPlanModel(Model):
    """The plan of the active map's floor, in axes of its own: x to the right, y up."""

    map: str
    metric: bool = Field(description="lengths are metres; false: map units of unknown scale")
    unit: float = Field(description="map units per metre; a guess unless the map is metric")
    R_ground_map: list[list[float]] = Field(description="turns positions of the map to the plan's x, y and up")
    low: Point = Field(description="where the smallest x and y of rooms and walls are")
    high: Point
    rooms: list[PlanRoom]
    doors: list[DoorModel]
    walls: list[list[Point]]
    places: list[PlanPlace] = Field(description="those that are not hidden")
    path: list[Point] = Field(description="of the drives that it was made from")


class NewRoomName(Question):
    """What a room shall be called."""

    name: Name | None = Field(description="null: as nobody had named it, Room 2 for example", examples=["Kitchen"])


class RoomMerge(Question):
    """Which rooms are one; it keeps id and name of the first."""

    rooms: list[str] = Field(min_length=2, max_length=50, examples=[["room-3f21aa", "room-77d0e2"]])


class RoomSplit(Question):
    """A line right across a room, from wall to wall, as on the plan: a door."""

    line: list[DrawnPoint] = Field(min_length=2, max_length=2, examples=[[[1.0, -1.5], [1.0, 1.5]]])


def room_model(active: ActiveMap, room: Room) -> RoomModel:
    plan, navigation = active.require_plan(), active.place_map.navigation
    return RoomModel.of(
        room,
        named=room.id in active.place_map.plan_edits.names,
        area_m2=room.area if navigation.is_metric else None,
        middle=room.middle.tolist(),
        doors=[door.id for door in plan.doors if room.id in door.rooms],
        places=[
            PlaceName(id=place.id, name=place.name)
            for place in active.visible_places
            if plan.room_of_place.get(place.id) == room.id
        ],
        suggestions=[_suggestion_model(active, suggestion) for suggestion in suggested(active.place_map, room)],
    )


def floor_plan_model(active: ActiveMap) -> FloorPlanModel:
    plan, place_map = active.require_plan(), active.place_map
    R, places = plan.R_ground_map, active.visible_places
    outlines = room_outlines(plan)
    corners = np.concatenate([plan.walls.reshape(-1, 2), *(line for outline in outlines for line in outline)])
    low, high = (corners.min(axis=0), corners.max(axis=0)) if len(corners) else (plan.low, plan.low)
    middles = _rounded(np.array([room.middle for room in plan.rooms]))
    ends = _rounded(np.array([door.ends for door in plan.doors]))
    centroids = _rounded((np.array([place.centroid_map for place in places]).reshape(-1, 3) @ R.T)[:, :2])
    return FloorPlanModel(
        map=place_map.id,
        metric=place_map.navigation.is_metric,
        unit=plan.unit,
        R_ground_map=R.tolist(),
        low=_rounded(low),
        high=_rounded(high),
        rooms=[
            PlanRoom.of(
                room,
                named=room.id in place_map.plan_edits.names,
                middle=middle,
                outline=[_rounded(line) for line in outline],
            )
            for room, middle, outline in zip(plan.rooms, middles, outlines, strict=True)
        ],
        doors=[
            DoorModel(id=door.id, rooms=list(door.rooms), ends=at, width=door.width, drawn=door.is_drawn)
            for door, at in zip(plan.doors, ends, strict=True)
        ],
        walls=_rounded(plan.walls),
        places=[
            PlanPlace(
                id=place.id,
                name=place.name,
                at=at,
                room=plan.room_of_place.get(place.id),
                colour=active.numbers.get(place.id, NO_PLACE),
                representative_image=(
                    f"/places/{place.id}/images/representative" if place.representative_keyframe >= 0 else None
                ),
            )
            for place, at in zip(places, centroids, strict=True)
        ],
        path=_rounded(driven_path(place_map.navigation, R)),
    )


def _suggestion_model(active: ActiveMap, suggestion: NameSuggestion) -> NameSuggestionModel:
    index, corners = suggestion.keyframe_index, suggestion.corners_px
    return NameSuggestionModel.of(
        suggestion,
        image=None if index is None else f"/maps/{active.place_map.id}/images/{index}.jpg",
        corners_px=None if corners is None else corners.tolist(),
    )


def _rounded(points: FloatArray) -> list[Any]:
    """Points (..., 2) to the millimetre: a plan of a thousand rooms travels to a phone."""
    rounded: list[Any] = np.round(points, 3).tolist()
    return rounded
