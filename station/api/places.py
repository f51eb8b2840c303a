"""/place/current, /places, /graph."""

from __future__ import annotations

import asyncio
from typing import Annotated, Literal

from fastapi import APIRouter, Query, Response

from station.api.deps import StationDep
from station.api.maps import image_response
from station.api.models import CurrentPlace, GraphModel, PlaceChange, PlaceModel, VisitModel
from station.api.problems import responses
from station.api.views import current_place, edge_model, place_model, visit_model
from station.map_library import keyframe_image, mean_image
from station.places.graph import to_graphml
from station.refusals import Unknown

router = APIRouter(tags=["places"])
IMAGE = {"content": {"image/jpeg": {}}, "description": "JPEG"}


@router.get("/place/current", summary="Which place is the robot at, how sure is that, and why")
async def place_current(station: StationDep) -> CurrentPlace:
    return current_place(station)


@router.get("/place/timeline", summary="Places visited since the station started, oldest first")
async def timeline(station: StationDep) -> list[VisitModel]:
    return [visit_model(visit) for visit in station.locating.visits]


@router.get(
    "/place/current/images/{t_robot_ns}.jpg",
    summary="The picture an answer rests on, while it is kept",
    response_class=Response,
    responses={200: IMAGE, **responses(404)},
)
async def query_image(t_robot_ns: int, station: StationDep) -> Response:
    image = station.locating.query_image(t_robot_ns)
    if image is None:
        raise Unknown("this picture is not kept any more; only the newest ones are")
    return image_response(image)


@router.get("/places", summary="Places of the active map", responses=responses(409))
async def places(station: StationDep) -> list[PlaceModel]:
    active = station.maps.require_active()
    return [place_model(active, place) for place in active.place_map.places]


@router.get("/places/{place_id}", summary="One place", responses=responses(404, 409))
async def place(place_id: str, station: StationDep) -> PlaceModel:
    active = station.maps.require_active()
    return place_model(active, active.place(place_id))


@router.patch("/places/{place_id}", summary="Rename a place", responses=responses(404, 409))
async def rename(place_id: str, change: PlaceChange, station: StationDep) -> PlaceModel:
    renamed = await station.rename_place(place_id, change.name)
    return place_model(station.maps.require_active(), renamed)


@router.get(
    "/places/{place_id}/images/{kind}",
    summary="The representative picture, or the mean one",
    response_class=Response,
    responses={200: IMAGE, **responses(404, 409)},
)
async def image(place_id: str, kind: Literal["representative", "mean"], station: StationDep) -> Response:
    active = station.maps.require_active()
    found = active.place(place_id)
    if kind == "representative":
        return image_response(keyframe_image(active.place_map, found.representative_keyframe))
    return image_response(await asyncio.to_thread(mean_image, active.place_map, found))


@router.get(
    "/graph",
    summary="The topological map",
    responses={200: {"content": {"application/graphml+xml": {}}}, **responses(409)},
)
async def graph(station: StationDep, format: Annotated[Literal["json", "graphml"], Query()] = "json") -> GraphModel:
    active = station.maps.require_active()
    if format == "graphml":
        return Response(to_graphml(active.place_map), media_type="application/graphml+xml")  # type: ignore[return-value]
    return GraphModel(
        map=active.place_map.id,
        nodes=[place_model(active, place) for place in active.place_map.places],
        edges=[edge_model(edge) for edge in active.place_map.edges],
    )
