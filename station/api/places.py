"""/place/current, /places, /graph."""

from __future__ import annotations

import asyncio
from typing import Annotated, Literal

from fastapi import APIRouter, Query, Response
from pydantic import TypeAdapter

from shared.bounded import shown
from station.api.deps import RobotDep, StationDep
from station.api.edits import VERSION, tell_version
from station.api.prepared import Prepared
from station.api.problems import responses
from station.api.schema.jobs import JobModel
from station.api.schema.places import (
    CurrentPlace,
    EdgeModel,
    GraphModel,
    PlaceChange,
    PlaceMerge,
    PlaceModel,
    PlacesChangeModel,
    RouteModel,
    UndoOrder,
    VisitModel,
    current_place,
    place_model,
    route_model,
    visit_model,
)
from station.api.streams import image_response
from station.errors import Conflict, Unknown
from station.library.active_maps import ActiveMap
from station.library.place_changes import PlacesChange
from station.library.place_images import deviation_image, keyframe_image, mean_image
from station.places.making.changes import without_hidden
from station.places.making.graph import places_called, shortest_route, to_graphml

router = APIRouter(tags=["places"])
of_robot = APIRouter(tags=["places"])
PLACES = TypeAdapter(list[PlaceModel])
IMAGE = {"content": {"image/jpeg": {}}, "description": "JPEG"}


@of_robot.get("/place/current", summary="Which room and place is the robot at, how sure is that, and why")
async def place_current(robot: RobotDep) -> CurrentPlace:
    return current_place(robot)


@of_robot.get("/place/timeline", summary="Places visited since the station started, oldest first")
async def timeline(robot: RobotDep) -> list[VisitModel]:
    return [visit_model(visit) for visit in robot.current_place.visits]


@of_robot.get(
    "/place/current/images/{t_robot_ns}.jpg",
    summary="The picture an answer rests on, while it is kept",
    response_class=Response,
    responses={200: IMAGE, **responses(404)},
)
async def query_image(t_robot_ns: int, robot: RobotDep) -> Response:
    image = robot.current_place.query_image(t_robot_ns)
    if image is None:
        raise Unknown("this picture is not kept any more; only the newest ones are")
    return image_response(image)


def _places_json(active: ActiveMap) -> bytes:
    return PLACES.dump_json([place_model(active, place) for place in active.place_map.places])


def _graph_json(active: ActiveMap) -> bytes:
    graph = GraphModel(
        map=active.place_map.id,
        metric=active.place_map.navigation.is_metric,
        nodes=[place_model(active, place) for place in active.visible_places],
        edges=[EdgeModel.of(edge) for edge in active.place_map.edges],
    )
    return graph.model_dump_json().encode()


_PLACES, _GRAPH = Prepared(_places_json), Prepared(_graph_json)


@router.get(
    "/places",
    summary="Places of the active map, hidden ones too",
    response_model=list[PlaceModel],
    responses=responses(409),
)
async def places(station: StationDep) -> Response:
    return await _PLACES.response(station.maps.active.require_first())


@router.get("/places/changes", summary="What people made of places and rooms, newest first", responses=responses(409))
async def changes(station: StationDep) -> list[PlacesChangeModel]:
    """Changes of the active map that can be taken back, one after the other; those taken back are not listed."""
    return [_change(change) for change in await station.maps.changes()]


def _change(change: PlacesChange) -> PlacesChangeModel:
    return PlacesChangeModel.of(change, map=change.map_id, unix_s=change.changed_wall_s)


@router.get("/places/{place_id}", summary="One place", responses=responses(404, 409))
async def place(place_id: str, station: StationDep) -> PlaceModel:
    active = station.maps.active.require_first()
    return place_model(active, active.place(place_id))


@router.post("/places/merge", summary="Make several places one", responses={**VERSION, **responses(404, 409)})
async def merge(order: PlaceMerge, station: StationDep, response: Response) -> PlaceModel:
    """The place keeps id and name of the first one; the others are gone. POST /places/undo takes it back."""
    edit = await station.merge_places(order.places)
    tell_version(response, edit)
    return place_model(edit.active, edit.active.place(order.places[0]))


@router.post("/places/undo", summary="Take back the newest change of places or rooms", responses=responses(409))
async def undo(station: StationDep, order: UndoOrder | None = None) -> PlacesChangeModel:
    """A name, hiding, a merge, a door. Answers what was taken back; 409 when another change came after `version`.

    Versions are counted for each map: give `map` with `version`, or a change of another map may be the one that goes.
    """
    return _change(await (station.undo_places(order.version, order.map) if order else station.undo_places(None)))


@router.post(
    "/places/repeatability",
    summary="Measure how surely each place would be found again",
    status_code=202,
    responses=responses(409),
)
async def measure(station: StationDep) -> JobModel:
    """Runs in the background: follow GET /jobs/{id}, whose result has 0..1 for each place's id; from 0.75 on stable."""
    return JobModel.of(station.measure_places())


@router.patch(
    "/places/{place_id}", summary="Rename, hide or show a place", responses={**VERSION, **responses(404, 409)}
)
async def change(place_id: str, change: PlaceChange, station: StationDep, response: Response) -> PlaceModel:
    """A hidden place is never the current one and not in the graph; it keeps its name. Both at once are two changes."""
    active = station.maps.active.require_first()
    place = active.place(place_id)
    if change.name is not None:
        edit = await station.rename_place(place_id, change.name)
        tell_version(response, edit)
        active, place = edit.active, edit.active.place(place_id)
    if change.hidden is not None and change.hidden != place.hidden:
        edit = await station.hide_place(place_id, change.hidden)
        tell_version(response, edit)
        active, place = edit.active, edit.active.place(place_id)
    return place_model(active, place)


@router.get(
    "/places/{place_id}/images/{kind}",
    summary="The representative picture, the mean one, or how much their brightness differs (white: 100 grey levels)",
    response_class=Response,
    responses={200: IMAGE, **responses(404, 409)},
)
async def image(place_id: str, kind: Literal["representative", "mean", "deviation"], station: StationDep) -> Response:
    active = station.maps.active.require_first()
    found = active.place(place_id)
    if kind == "representative":
        return image_response(keyframe_image(active.place_map, found.representative_keyframe))
    made = mean_image if kind == "mean" else deviation_image
    return image_response(await asyncio.to_thread(made, active.place_map, found))


@router.get(
    "/graph",
    summary="The topological map",
    response_model=GraphModel,
    responses={200: {"content": {"application/graphml+xml": {}}}, **responses(409)},
)
async def graph(station: StationDep, format: Annotated[Literal["json", "graphml"], Query()] = "json") -> Response:
    active = station.maps.active.require_first()
    if format == "graphml":
        return Response(to_graphml(without_hidden(active.place_map)), media_type="application/graphml+xml")
    return await _GRAPH.response(active)


Called = Annotated[str, Query(min_length=1, max_length=80, description="id or name of a place", examples=["Kitchen"])]


@router.get("/graph/route", summary="The shortest way between two places", responses=responses(404, 409))
async def route(start: Called, goal: Called, station: StationDep) -> RouteModel:
    """Along the edges of the graph, with the bearing of each leg; by names, in which upper and lower case are one."""
    place_map = without_hidden(station.maps.active.require_first().place_map)
    for word in (start, goal):
        if not places_called(place_map, word):
            raise Unknown(f"the graph has no place {shown(word)}; GET /graph lists them")
    found = shortest_route(place_map, start, goal)
    if found is None:
        raise Conflict(f"no edges lead from {start} to {goal}")
    return route_model(place_map, found)
