"""/rooms, /doors, /floorplan: the rooms of the active map, and what people make of them."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Annotated, Literal

import numpy as np
from fastapi import APIRouter, Query, Response

from station.api.deps import StationDep
from station.api.edits import VERSION, tell_version
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
from station.library.active_maps import ActiveMap
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
    return _rooms(station.maps.active.require_first())


@router.get("/rooms/{room_id}", summary="One room", responses=responses(404, 409))
async def room(room_id: str, station: StationDep) -> RoomModel:
    return _room(station.maps.active.require_first(), room_id)


@router.patch("/rooms/{room_id}", summary="Name a room", responses={**VERSION, **responses(404, 409)})
async def rename(room_id: str, new: NewRoomName, station: StationDep, response: Response) -> RoomModel:
    """Names are unique in a map; null takes a room's name from it. POST /places/undo undoes it, like all of rooms."""
    station.maps.active.require_first().require_plan()
    edit = await station.rename_room(room_id, new.name)
    tell_version(response, edit)
    return _room(edit.active, room_id)


@router.post("/rooms/merge", summary="Make several rooms one", responses={**VERSION, **responses(404, 409)})
async def merge(order: RoomMerge, station: StationDep, response: Response) -> RoomModel:
    """Erases the doors between them; the room keeps id and name of the first one."""
    station.maps.active.require_first().require_plan()
    edit = await station.merge_rooms(order.rooms)
    tell_version(response, edit)
    return _room(edit.active, order.rooms[0])


@router.post("/rooms/split", summary="Draw a door", responses={**VERSION, **responses(409)})
async def split(order: RoomSplit, station: StationDep, response: Response) -> list[RoomModel]:
    """A line right across a room, from wall to wall, makes two of it, now and in later plans of this map.

    The larger part keeps id and name; of a room that was made of several, the part that had them before. Answers all
    rooms as they are then.
    """
    station.maps.active.require_first().require_plan()
    edit = await station.split_room(np.array(order.line, dtype=np.float64))
    tell_version(response, edit)
    return _rooms(edit.active)


@router.delete("/doors/{door_id}", summary="Erase a door", responses={**VERSION, **responses(404, 409)})
async def erase(door_id: str, station: StationDep, response: Response) -> list[RoomModel]:
    """What it led to is one room with where it led from, now and in later plans. Answers all rooms as they are then.

    Of a door that nobody went through it is noted that there is none.
    """
    station.maps.active.require_first().require_plan()
    edit = await station.erase_door(door_id)
    tell_version(response, edit)
    return _rooms(edit.active)


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


def _rooms(active: ActiveMap) -> list[RoomModel]:
    return [room_model(active, room) for room in active.require_plan().rooms]


def _room(active: ActiveMap, room_id: str) -> RoomModel:
    active.require_plan()
    return room_model(active, active.room(room_id))
