"""A floor plan as JSON in the manner of GeoJSON (RFC 7946), but on the map's ground instead of the globe."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from shared.geometry import FloatArray
from station.model.floor_plan import FloorPlan
from station.model.place_map import PlaceMap
from station.places.rooms.drawing import room_outlines


def floorplan_json(plan: FloorPlan, place_map: PlaceMap | None = None) -> bytes:
    """A FeatureCollection: rooms, doors, walls, and where a map is given its places and path; map units, y up."""
    return json.dumps(floorplan_document(plan, place_map)).encode()


def floorplan_document(plan: FloorPlan, place_map: PlaceMap | None = None) -> dict[str, Any]:
    """The same as plain values."""
    features = [*_rooms(plan), *_doors(plan), _feature("walls", "MultiLineString", _rounded(plan.walls))]
    if place_map is not None:
        features += _places(plan, place_map)
        p = place_map.navigation.keyframes.T_world_cam[:, :3, 3] @ plan.R_ground_map.T
        features.append(_feature("path", "LineString", _rounded(p[np.isfinite(p).all(axis=1), :2])))
    return {
        "type": "FeatureCollection",
        "R_ground_map": plan.R_ground_map.tolist(),
        "units_per_metre": plan.unit,
        "metric": None if place_map is None else place_map.navigation.is_metric,
        "features": features,
    }


def _rooms(plan: FloorPlan) -> list[dict[str, Any]]:
    found = []
    for room, outlines in zip(plan.rooms, room_outlines(plan), strict=True):
        rings = [[_rounded(np.vstack([outline, outline[:1]]))] for outline in outlines]
        middle = _rounded(room.middle)
        found.append(
            _feature("room", "MultiPolygon", rings, id=room.id, name=room.name, area=round(room.area, 3), middle=middle)
        )
    return found


def _doors(plan: FloorPlan) -> list[dict[str, Any]]:
    return [
        _feature("door", "LineString", _rounded(door.ends), id=door.id, rooms=list(door.rooms),
                 width=round(door.width, 3), drawn=door.is_drawn)
        for door in plan.doors
    ]  # fmt: skip


def _places(plan: FloorPlan, place_map: PlaceMap) -> list[dict[str, Any]]:
    found = []
    for place in place_map.places:
        if not place.hidden:
            at = _rounded((plan.R_ground_map @ place.centroid_map)[:2])
            room = plan.room_of_place.get(place.id)
            found.append(_feature("place", "Point", at, id=place.id, name=place.name, room=room))
    return found


def _feature(kind: str, geometry: str, coordinates: Any, **properties: Any) -> dict[str, Any]:
    return {
        "type": "Feature",
        "properties": {"kind": kind, **properties},
        "geometry": {"type": geometry, "coordinates": coordinates},
    }


def _rounded(p: FloatArray) -> Any:
    return np.round(p, 4).tolist()
