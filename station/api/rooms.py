"""/rooms, /doors, /floorplan: the rooms of the active map, and what people make of them."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Annotated, Literal

import numpy as np
from fastapi import APIRouter, Query, Response

from station.api.deps import StationDep
from station.api.prepared import Prepared
from station.api.problems import responses
from station.api.schema.rooms import (
    FloorPlanModel,
    NewRoomName,
    RoomMerge,
    RoomModel,
    RoomSplit,
    floor_plan_model,
    room_model,
)
from station.app import Station
from station.model.floor_plan import FloorPlan
from station.model.place_map import PlaceMap
from station.places.making.changes import without_hidden
from station.places.rooms.geojson import floorplan_json
from station.places.rooms.png import floorplan_png
from station.places.rooms.svg import floorplan_svg

router = APIRouter(tags=["rooms"])
DRAWN: dict[str, tuple[Callable[[FloorPlan, PlaceMap], bytes], str]] = {
    "geojson": (floorplan_json, "application/geo+json"),
    "svg": (floorplan_svg, "image/svg+xml"),
    "png": (floorplan_png, "image/png"),
}
_PLAN = Prepared(lambda active: floor_plan_model(active).model_dump_json().encode())


@router.get("/rooms", summary="Rooms of the active map", responses=responses(409))
async def rooms(station: StationDep) -> list[RoomModel]:
    return _rooms(station)


@router.get("/rooms/{room_id}", summary="One room", responses=responses(404, 409))
async def room(room_id: str, station: StationDep) -> RoomModel:
    return _room(station, room_id)


@router.patch("/rooms/{room_id}", summary="Name a room", responses=responses(404, 409))
async def rename(room_id: str, new: NewRoomName, station: StationDep) -> RoomModel:
    """Names are unique in a map; null takes a room's name from it. POST /places/undo undoes it, like all of rooms."""
    _room(station, room_id)
    await station.rename_room(room_id, new.name)
    return _room(station, room_id)


@router.post("/rooms/merge", summary="Make several rooms one", responses=responses(404, 409))
async def merge(order: RoomMerge, station: StationDep) -> RoomModel:
    """Erases the doors between them; the room keeps id and name of the first one."""
    station.maps.active.require_first().require_plan()
    merged = await station.merge_rooms(order.rooms)
    return _room(station, merged.id)


@router.post("/rooms/split", summary="Draw a door", responses=responses(409))
async def split(order: RoomSplit, station: StationDep) -> list[RoomModel]:
    """A line right across a room, from wall to wall, makes two of it, now and in later plans of this map.

    The larger part keeps id and name; of a room that was made of several, the part that had them before. Answers all
    rooms as they are then.
    """
    station.maps.active.require_first().require_plan()
    await station.split_room(np.array(order.line, dtype=np.float64))
    return _rooms(station)


@router.delete("/doors/{door_id}", summary="Erase a door", responses=responses(404, 409))
async def erase(door_id: str, station: StationDep) -> list[RoomModel]:
    """What it led to is one room with where it led from, now and in later plans. Answers all rooms as they are then."""
    station.maps.active.require_first().require_plan()
    await station.erase_door(door_id)
    return _rooms(station)


@router.get(
    "/floorplan",
    summary="The floor plan of the active map",
    response_model=FloorPlanModel,
    responses={200: {"content": {media_type: {} for _, media_type in DRAWN.values()}}, **responses(409)},
)
async def floorplan(
    station: StationDep, format: Annotated[Literal["json", "geojson", "svg", "png"], Query()] = "json"
) -> Response:
    """JSON as the page draws it; a GeoJSON FeatureCollection in map units; or a drawing to print."""
    active = station.maps.active.require_first()
    plan = active.require_plan()
    if format == "json":
        return await _PLAN.response(active)
    make, media_type = DRAWN[format]
    return Response(await asyncio.to_thread(make, plan, without_hidden(active.place_map)), media_type=media_type)


def _rooms(station: Station) -> list[RoomModel]:
    active = station.maps.active.require_first()
    return [room_model(active, room) for room in active.require_plan().rooms]


def _room(station: Station, room_id: str) -> RoomModel:
    active = station.maps.active.require_first()
    active.require_plan()
    return room_model(active, active.room(room_id))
