"""Places, their graph, and which one the robot is at."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Literal, Self

from pydantic import ConfigDict, Field, model_validator

from station.api.schema.base import Model, Name, Question
from station.library.active_maps import ActiveMap
from station.model.place_answer import RoomCandidate, is_elsewhere
from station.model.place_map import Place, PlaceMap
from station.model.points import NO_PLACE
from station.places.making.graph import Route
from station.robots.session import RobotSession
from station.robots.visits import Visit


class PlaceName(Model):
    id: str = Field(examples=["place-5a1c09"])
    name: str = Field(examples=["Kitchen"])


PLACE_ROOM = Field(description="id of the room that `place` is in", examples=["room-3f21aa"])
PLACE_ELSEWHERE = Field(
    description="that is another room than `room`: the nearest place is behind a door or a thin wall. In a doorway the "
    "robot is in both",
    examples=[False],
)


class PlaceProbability(PlaceName):
    probability: float = Field(
        description="that it is the nearest one or within 10 % of that: several may sum to more than 1", examples=[0.07]
    )
    map: str = Field(description="id of the active map that it is a place of", examples=["map-0a1b"])


class Evidence(Model):
    """Why: the running picture and the map's picture that shows the same landmarks."""

    query_image: str | None = Field(examples=["/place/current/images/812345678901.jpg"])
    map_image: str | None = Field(examples=["/maps/map-0a1b/images/17.jpg"])
    inliers: int = Field(description="landmarks of the map found where they belong", examples=[84])
    age_s: float | None = Field(description="since the picture that was recognised", examples=[0.4])


class RoomName(Model):
    id: str = Field(examples=["room-3f21aa"])
    name: str = Field(examples=["Kitchen"])


class RoomProbability(RoomName):
    probability: float = Field(
        description="that the robot is in it or in a doorway of it: two may sum to more than 1", examples=[0.99]
    )


class CurrentPlace(Model):
    """Which place the robot is at, and in which room. `place` is null unless the state is "known"; the room may be
    known earlier, and between places.
    """

    state: Literal["known", "unknown", "lost"]
    place: PlaceName | None
    place_room: str | None = PLACE_ROOM
    place_elsewhere: bool = PLACE_ELSEWHERE
    probability: float = Field(
        description="that `place` is the nearest one or within 10 % of that; of the likeliest one while none is known",
        examples=[0.97],
    )
    distance_m: float | None = Field(description="robot to the place's centroid; null without a metric map")
    position_map: list[float] | None = Field(description="x, y, z of the robot in `map`", examples=[[1.2, 0.4, 0.1]])
    forward_map: list[float] | None = Field(
        description="x, y, z of where the robot's front points, of length 1; null without a position",
        examples=[[0.0, 1.0, 0.0]],
    )
    sigma_position_m: float | None = Field(
        description="1 sigma per axis of the position; null without one, or without a metric map", examples=[0.04]
    )
    age_s: float | None = Field(description="since the picture the answer is about was taken", examples=[0.2])
    map: str | None = Field(
        description="id of the active map that place, position and evidence are of; while there are none, the first",
        examples=["map-0a1b"],
    )
    alternatives: list[PlaceProbability]
    room: RoomProbability | None = Field(description="null while none is probable enough, or the map has no rooms")
    room_alternatives: list[RoomProbability] = Field(description="what else it may be, the likeliest first")
    one_of_two: list[RoomProbability] = Field(
        description="while `room` is null, the two it is surely one of, such as rooms that look alike; else empty",
        examples=[[]],
    )
    doorway: str | None = Field(
        description="id of the door of GET /floorplan in which the robot is: both of its rooms are right then",
        examples=[None],
    )
    evidence: Evidence
    preparing: float | None = Field(
        description="0..1 while the map is prepared for answers; else null", examples=[None]
    )
    withheld: bool = Field(
        description="the calibration does not fit: no place or room is told, and position, alternatives and their "
        "probabilities are what would follow if it did",
        examples=[False],
    )
    reason: str = Field(description="in a sentence", examples=["84 landmarks of the map were recognised 0.2 s ago"])
    t_robot_ns: int | None = Field(description="sensor time the answer is about, robot clock")
    pose_map: list[float] | None = Field(
        description="T_map_cam of the newest picture, row-major 4x4; null when it was not recognised in `map`"
    )


class VisitModel(Model):
    """A stretch of time with one answer."""

    state: Literal["known", "unknown", "lost"]
    place: PlaceName | None
    place_room: str | None = PLACE_ROOM
    place_elsewhere: bool = PLACE_ELSEWHERE
    room: RoomName | None
    start_unix_s: float
    end_unix_s: float


class PlaceModel(Model):
    """A place of the active map."""

    id: str
    name: str
    centroid_map: list[float]
    radius: float = Field(description="RMS distance of its landmarks from the centroid, map units")
    landmarks: int
    images: int = Field(description="keyframes that saw it")
    quality: float = Field(description="0..1, how clearly it stands out, and of how many landmarks")
    representative_image: str | None
    mean_image: str | None
    deviation_image: str | None = Field(description="how much the brightness of its pictures differs")
    colour: int = Field(
        description="its number in GET /maps/{id}/landmarks; neighbours differ in the remainder by 12", examples=[5]
    )
    hidden: bool = Field(description="by a person: never the current place, and not in the graph")
    named: bool = Field(description="a person gave it its name")
    room: str | None = Field(description="id of the room it is in", examples=["room-3f21aa"])


class PlaceChange(Question):
    """What is to be otherwise; what is left out or null stays, and one thing must be said."""

    model_config = ConfigDict(json_schema_extra={"minProperties": 1})

    name: Name | None = Field(default=None, examples=["Kitchen"])
    hidden: bool | None = Field(default=None, examples=[False])

    @model_validator(mode="after")
    def _says_something(self) -> Self:
        if self.name is None and self.hidden is None:
            raise ValueError("nothing is to be changed: give name or hidden")
        return self


class PlaceMerge(Question):
    """Which places are one; it keeps id and name of the first."""

    places: list[str] = Field(min_length=2, max_length=50, examples=[["place-5a1c09", "place-77d0e2"]])


class PlacesChangeModel(Model):
    """What a person made of places or rooms: renamed, hidden, merged, doors drawn and erased."""

    map: str = Field(description="id of the map that was changed", examples=["map-0a1b"])
    version: int = Field(description="of that map, that the change led to", examples=[4])
    why: str = Field(examples=["Kitchen and Place 3 are one"])
    unix_s: float


class UndoOrder(Question):
    """What to take back."""

    version: int | None = Field(
        default=None,
        ge=1,
        le=2**53,
        description="only if this is the newest change; null: whatever it is",
        examples=[4],
    )
    map: str | None = Field(
        default=None,
        max_length=200,
        description="only if this map is in use; null: whichever is",
        examples=["map-0a1b"],
    )


class EdgeModel(Model):
    a: str
    b: str
    bearing_rad: float = Field(description="a to b in the ground plane, from +x towards +y")
    distance: float = Field(description="between centroids, map units")
    kind: Literal["seen together", "driven between", "nearest"]


class GraphModel(Model):
    """The topological map."""

    map: str
    metric: bool = Field(description="distances are metres; false: of unknown scale")
    nodes: list[PlaceModel]
    edges: list[EdgeModel]


class RouteModel(Model):
    """The shortest way along the graph's edges."""

    map: str
    metric: bool = Field(description="distances are metres; false: of unknown scale")
    places: list[PlaceName] = Field(description="from start to goal")
    legs: list[EdgeModel] = Field(description="from each place to the next one")
    length: float = Field(description="of all legs, map units", examples=[4.9])


def current_place(robot: RobotSession) -> CurrentPlace:
    """The answer to the question all this is for."""
    report = robot.current_place.report
    first = robot.active_maps.first
    active = None if report is None else robot.active_maps.find(report.map_id)
    # Places may have been renamed, hidden or merged since the answer was made: what they are now counts.
    known = {place.id: (place, one) for one in robot.active_maps.all for place in one.visible_places}
    is_outdated = report is not None and report.answer.place is not None and report.answer.place.id not in known
    if report is None or active is None or is_outdated:
        return CurrentPlace(
            state="unknown",
            place=None,
            place_room=None,
            place_elsewhere=False,
            probability=0.0,
            distance_m=None,
            position_map=None,
            forward_map=None,
            sigma_position_m=None,
            age_s=None,
            map=first.place_map.id if first else None,
            alternatives=[],
            room=None,
            room_alternatives=[],
            one_of_two=[],
            doorway=None,
            evidence=Evidence(query_image=None, map_image=None, inliers=0, age_s=None),
            withheld=False,
            reason=_no_answer_yet(robot),
            preparing=robot.current_place.progress if first else None,
            t_robot_ns=None,
            pose_map=None,
        )
    answer, map_id = report.answer, report.map_id
    room_names = {room.id: room.name for one in robot.active_maps.all for room in one.rooms}

    def rooms_now(*candidates: RoomCandidate | None) -> Iterator[RoomProbability]:
        """Those that are rooms still, by the names that they have now."""
        for c in candidates:
            if c is not None and c.id in room_names:
                yield RoomProbability(id=c.id, name=room_names[c.id], probability=_probability(c.probability))

    likeliest = answer.place or (answer.alternatives[0] if answer.alternatives else None)
    place_room = None if answer.place is None else known[answer.place.id][1].place_map.room_of(answer.place.id)
    room = next(rooms_now(answer.room), None)
    is_metric = active.place_map.navigation.is_metric
    two = list(rooms_now(*answer.one_of_two))
    others = list(rooms_now(*answer.room_alternatives))
    both = {one.id for one in (room, *others[:1]) if one is not None}
    doors = {door.id for one in robot.active_maps.all for door in one.doors if both == set(door.rooms)}
    evidence_ns, keyframe = answer.evidence_t_robot_ns, answer.evidence_keyframe
    has_query = evidence_ns is not None and robot.current_place.query_image(evidence_ns) is not None
    return CurrentPlace(
        state=answer.state,
        place=None if answer.place is None else _name_of(known[answer.place.id][0]),
        place_room=place_room,
        place_elsewhere=is_elsewhere(place_room, room.id if room else None),
        probability=_probability(likeliest.probability if likeliest else 0.0),
        distance_m=answer.distance if is_metric else None,
        position_map=None if answer.position_map is None else [float(x) for x in answer.position_map],
        forward_map=None if answer.forward_map is None else [float(x) for x in answer.forward_map],
        sigma_position_m=answer.sigma_position if is_metric else None,
        age_s=_age_s(robot, answer.t_robot_ns),
        map=map_id,
        alternatives=[
            PlaceProbability(id=c.id, name=place.name, probability=_probability(c.probability), map=one.place_map.id)
            for c in answer.alternatives
            if c.id in known
            for place, one in [known[c.id]]
        ],
        room=room,
        room_alternatives=others,
        one_of_two=two if len(two) == 2 else [],  # not where they were made one meanwhile
        doorway=answer.doorway if answer.doorway in doors else None,  # not of a door that was erased meanwhile
        evidence=Evidence(
            query_image=f"{robot.path}/place/current/images/{evidence_ns}.jpg" if has_query else None,
            map_image=None if keyframe is None else f"/maps/{map_id}/images/{keyframe}.jpg",
            inliers=answer.inliers,
            age_s=None if evidence_ns is None else _age_s(robot, evidence_ns),
        ),
        withheld=answer.is_withheld,
        reason=robot.looks_aside or answer.reason,
        preparing=None,
        t_robot_ns=answer.t_robot_ns,
        pose_map=None if report.T_map_cam is None else [float(x) for x in report.T_map_cam.ravel()],
    )


def _name_of(place: Place) -> PlaceName:
    return PlaceName(id=place.id, name=place.name)


def _no_answer_yet(robot: RobotSession) -> str:
    if robot.active_maps.first is None:
        return "no map is active; record a navigation, build a map from it and choose it"
    if not robot.state.connected:
        return "no robot is connected"
    if robot.current_place.progress is not None:
        return f"getting the map ready: {robot.current_place.status}"
    return robot.looks_aside or f"no picture was looked at yet ({robot.current_place.status})"


def _probability(p: float) -> float:
    return min(1.0, max(0.0, p))


def _age_s(robot: RobotSession, t_robot_ns: int) -> float | None:
    t_station_ns = robot.link.to_station_ns(t_robot_ns)
    return None if t_station_ns is None else max(0.0, (time.monotonic_ns() - t_station_ns) * 1e-9)


def visit_model(visit: Visit) -> VisitModel:
    return VisitModel.of(
        visit,
        place=None if visit.place_id is None else PlaceName(id=visit.place_id, name=visit.place_name),
        room=None if visit.room_id is None else RoomName(id=visit.room_id, name=visit.room_name),
        start_unix_s=visit.start_wall_s,
        end_unix_s=visit.end_wall_s,
    )


def place_model(active: ActiveMap, place: Place) -> PlaceModel:
    has_images = place.representative_keyframe >= 0
    return PlaceModel.of(
        place,
        centroid_map=[float(x) for x in place.centroid_map],
        landmarks=len(place.landmark_index),
        images=len(place.keyframe_index),
        representative_image=f"/places/{place.id}/images/representative" if has_images else None,
        mean_image=f"/places/{place.id}/images/mean" if has_images else None,
        deviation_image=f"/places/{place.id}/images/deviation" if has_images else None,
        colour=active.numbers.get(place.id, NO_PLACE),
        room=None if active.place_map.plan is None else active.place_map.plan.room_of_place.get(place.id),
    )


def route_model(place_map: PlaceMap, route: Route) -> RouteModel:
    return RouteModel.of(
        route,
        map=place_map.id,
        metric=place_map.navigation.is_metric,
        places=[PlaceName(id=i, name=name) for i, name in zip(route.place_ids, route.names, strict=True)],
        legs=[EdgeModel.of(edge) for edge in route.legs],
    )
