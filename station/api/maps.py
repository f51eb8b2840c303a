"""/maps: the map library."""

from __future__ import annotations

import asyncio

from fastapi import APIRouter, Response

from shared.bounded import shown
from station.api.deps import StationDep
from station.api.points import BINARY, WantsPly, ply_response, points_response
from station.api.problems import responses
from station.api.schema.base import NewName
from station.api.schema.jobs import JobModel
from station.api.schema.maps import MapChoice, MapModel, MapOrder, map_model
from station.api.streams import image_response
from station.errors import Unknown
from station.library.place_images import keyframe_image
from station.model.points import pack_points

router = APIRouter(tags=["maps"])


@router.get("/maps", summary="All maps")
async def maps(station: StationDep) -> list[MapModel]:
    return [map_model(summary, station.maps.active) for summary in await station.maps.list()]


@router.post("/maps", summary="Build a map from navigations", status_code=202, responses=responses(404, 409))
async def build(order: MapOrder, station: StationDep) -> JobModel:
    """Runs in the background: follow GET /jobs/{id}, whose result names the map; DELETE /jobs/{id} cancels."""
    return JobModel.of(station.build_map(order.navigations, order.name, order.mode, order.activate, order.places))


@router.put("/maps/active", summary="Choose the map in use, or several", responses=responses(404, 409))
async def activate(choice: MapChoice, station: StationDep) -> MapModel | None:
    """The robots are looked for in `id` and in the maps of `also`; GET /places and GET /graph are those of `id`.

    409 where two of them are of the same rooms: made from a common navigation, or one from the other.
    """
    if choice.id is None:
        await station.use_maps()
        return None
    await station.use_maps(choice.id, *choice.also)
    for summary in await station.maps.list():
        if summary.id == choice.id:
            return map_model(summary, station.maps.active)
    raise Unknown(f"there is no map {shown(choice.id)}; GET /maps lists them")


@router.patch("/maps/{map_id}", summary="Rename a map", responses=responses(404, 409))
async def rename(map_id: str, name: NewName, station: StationDep) -> MapModel:
    return map_model(await station.maps.rename(map_id, name.name), station.maps.active)


@router.delete("/maps/{map_id}", summary="Delete a map", status_code=204, responses=responses(404, 409))
async def delete(map_id: str, station: StationDep) -> None:
    """It goes into the bin: POST /maps/{id}/restore brings it back for seven days.

    409 for the map whose places are in use; another one of those that are active is no longer looked in.
    """
    await station.delete_map(map_id)


@router.post("/maps/{map_id}/restore", summary="Bring a deleted map back", responses=responses(404, 409))
async def restore(map_id: str, station: StationDep) -> MapModel:
    return map_model(await station.restore_map(map_id), station.maps.active)


@router.get(
    "/maps/{map_id}/landmarks",
    summary="A map's cloud, with the number of each point's place",
    response_class=Response,
    responses={200: BINARY, **responses(404, 409)},
)
async def landmarks(map_id: str, station: StationDep, is_ply: WantsPly = False) -> Response:
    seen = await station.maps.load(map_id)
    cloud = seen.place_map.navigation.landmarks
    if is_ply:
        return await ply_response(cloud.p_world, cloud.rgb, map_id, map_id)
    table = await asyncio.to_thread(pack_points, cloud.p_world, cloud.rgb, seen.place_of_point)
    return points_response(table, 0, len(cloud), map_id)


@router.get(
    "/maps/{map_id}/images/{keyframe}.jpg",
    summary="A picture the map was made of",
    response_class=Response,
    responses={200: {"content": {"image/jpeg": {}}, "description": "JPEG or PNG"}, **responses(404, 409)},
)
async def image(map_id: str, keyframe: int, station: StationDep) -> Response:
    encoded = keyframe_image((await station.maps.load(map_id)).place_map, keyframe)
    return image_response(encoded)
