"""The place graph: which places are adjacent, in which direction and how far, and the way from one to another."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import networkx as nx
import numpy as np

from shared.errors import DataError
from shared.geometry import FloatArray, IntArray
from station.model.navigation import Navigation
from station.model.place_map import EdgeKind, Place, PlaceEdge, PlaceMap
from station.places.making.scale import ground_rotation

MIN_SHARED_KEYFRAMES = 2
MIN_SHARED_SHARE = 0.15  # of the less seen place's keyframes


@dataclass(frozen=True, slots=True)
class Route:
    """The shortest way along the graph's edges."""

    place_ids: tuple[str, ...]
    names: tuple[str, ...]
    length: float  # map units, between centroids
    legs: tuple[PlaceEdge, ...]  # from each place to the next one, bearings likewise


def place_edges(navigation: Navigation, places: Sequence[Place]) -> tuple[PlaceEdge, ...]:
    """Edges of places that are seen together or driven between; nearest places join what is left apart.

    Of three places that all see each other the longest edge is dropped (relative neighbourhood): a graph in which
    everything neighbours everything says nothing.
    """
    if len(places) < 2:
        return ()
    R_ground_map = ground_rotation(navigation)
    centroid = np.array([place.centroid_map for place in places])
    distance = np.linalg.norm(centroid[:, None] - centroid[None], axis=2)
    driven = _driven_between(navigation, centroid)
    seen = _without_detours(_seen_together(places), distance, keep=driven)
    kinds: dict[tuple[int, int], EdgeKind] = dict.fromkeys(seen, "seen together")
    kinds.update(dict.fromkeys(driven, "driven between"))
    graph = nx.Graph()
    graph.add_nodes_from(range(len(places)))
    graph.add_edges_from(kinds)
    for a, b in _joining(graph, distance):
        kinds[a, b] = "nearest"
    return tuple(
        PlaceEdge(
            a=places[a].id,
            b=places[b].id,
            bearing_rad=_bearing(R_ground_map @ (centroid[b] - centroid[a])),
            distance=float(distance[a, b]),
            kind=kind,
        )
        for (a, b), kind in sorted(kinds.items())
    )


def nearest_place_along(navigation: Navigation, centroid: FloatArray) -> IntArray:
    """(F,) index of the place nearest to the camera at every keyframe."""
    centres = navigation.keyframes.T_world_cam[:, :3, 3]
    return np.linalg.norm(centres[:, None] - centroid[None], axis=2).argmin(axis=1).astype(np.int64)


def to_networkx(place_map: PlaceMap) -> nx.Graph:
    """The graph with its attributes, for routes and for other tools."""
    graph = nx.Graph(map=place_map.id, name=place_map.name, metric=place_map.navigation.is_metric)
    for place in place_map.places:
        x, y, z = (float(c) for c in place.centroid_map)
        graph.add_node(
            place.id, name=place.name, x=x, y=y, z=z, radius=place.radius, quality=place.quality,
            landmarks=len(place.landmark_index), keyframes=len(place.keyframe_index),
        )  # fmt: skip
    for edge in place_map.edges:
        graph.add_edge(
            edge.a, edge.b, bearing_rad=edge.bearing_rad, bearing_from=edge.a, distance=edge.distance, kind=edge.kind
        )
    return graph


def to_graphml(place_map: PlaceMap) -> str:
    """GraphML text; the bearing of an edge holds from `bearing_from` to its other end."""
    return "\n".join(nx.generate_graphml(to_networkx(place_map))) + "\n"


def to_json_dict(place_map: PlaceMap, repeatability: Mapping[str, float] | None = None) -> dict[str, object]:
    """`{"nodes": [...], "edges": [...]}` of plain values; with the repeatability of places, by id, where measured."""
    measured = repeatability or {}
    graph = to_networkx(place_map)
    return {
        "map": place_map.id,
        "nodes": [
            {"id": node, **values, **({"repeatability": measured[node]} if node in measured else {})}
            for node, values in graph.nodes(data=True)
        ],
        "edges": [{"a": edge.a, "b": edge.b, "bearing_rad": edge.bearing_rad, "distance": edge.distance,
                   "kind": edge.kind} for edge in place_map.edges],
    }  # fmt: skip


def shortest_route(place_map: PlaceMap, start: str, goal: str) -> Route | None:
    """The shortest route between two places, each given by name or id; None where no edge leads.

    Raises:
        DataError: a name that no place, or more than one, has.
    """
    ids = [find_place(place_map, word).id for word in (start, goal)]
    graph = to_networkx(place_map)
    try:
        length, path = nx.single_source_dijkstra(graph, ids[0], ids[1], weight="distance")
    except nx.NetworkXNoPath:
        return None
    edges = {frozenset((edge.a, edge.b)): edge for edge in place_map.edges}
    legs = tuple(_leaving(edges[frozenset(pair)], pair[0]) for pair in itertools.pairwise(path))
    return Route(tuple(path), tuple(graph.nodes[node]["name"] for node in path), float(length), legs)


def _leaving(edge: PlaceEdge, start: str) -> PlaceEdge:
    """The edge as seen from this end of it: the way back points the other way."""
    if edge.a == start:
        return edge
    return replace(edge, a=edge.b, b=edge.a, bearing_rad=math.remainder(edge.bearing_rad + math.pi, math.tau))


def places_called(place_map: PlaceMap, word: str) -> list[Place]:
    """The place with this id, or those with this name (upper and lower case are one)."""
    return [p for p in place_map.places if p.id == word] or [
        p for p in place_map.places if p.name.casefold() == word.casefold()
    ]


def find_place(place_map: PlaceMap, word: str) -> Place:
    """The one place with this id or name.

    Raises:
        DataError: a name that no place, or more than one, has.
    """
    found = places_called(place_map, word)
    if len(found) == 1:
        return found[0]
    if found:
        raise DataError(f'{len(found)} places are named "{word}"; give the id ({", ".join(p.id for p in found)})')
    names = ", ".join(p.name for p in place_map.places) or "none"
    raise DataError(f'map "{place_map.name}" has no place "{word}"; its places: {names}')


def _bearing(delta: FloatArray) -> float:
    return math.atan2(float(delta[1]), float(delta[0]))


def _seen_together(places: Sequence[Place]) -> set[tuple[int, int]]:
    seen_from = [set(place.keyframe_index.tolist()) for place in places]
    return {
        (a, b)
        for a, b in itertools.combinations(range(len(places)), 2)
        if len(seen_from[a] & seen_from[b])
        >= max(MIN_SHARED_KEYFRAMES, MIN_SHARED_SHARE * min(len(seen_from[a]), len(seen_from[b])))
    }


def _driven_between(navigation: Navigation, centroid: FloatArray) -> set[tuple[int, int]]:
    nearest = nearest_place_along(navigation, centroid).tolist()
    segment = navigation.keyframes.segment.tolist()
    pairs: set[tuple[int, int]] = set()
    for (a, piece_a), (b, piece_b) in itertools.pairwise(zip(nearest, segment, strict=True)):
        if a != b and piece_a == piece_b:
            pairs.add((min(a, b), max(a, b)))
    return pairs


def _without_detours(
    pairs: set[tuple[int, int]], distance: FloatArray, keep: set[tuple[int, int]]
) -> set[tuple[int, int]]:
    connected = pairs | keep

    def is_detour(a: int, b: int) -> bool:
        return any(
            c not in (a, b)
            and (min(a, c), max(a, c)) in connected
            and (min(b, c), max(b, c)) in connected
            and max(distance[a, c], distance[b, c]) < distance[a, b]
            for c in range(len(distance))
        )

    return {(a, b) for a, b in pairs if not is_detour(a, b)}


def _joining(graph: nx.Graph, distance: FloatArray) -> Iterable[tuple[int, int]]:
    """Shortest edges that make the graph connected (Kruskal over its components)."""
    component = {node: k for k, nodes in enumerate(nx.connected_components(graph)) for node in nodes}
    for a, b in sorted(itertools.combinations(sorted(component), 2), key=lambda pair: float(distance[pair])):
        if component[a] != component[b]:
            old, new = component[b], component[a]
            component = {node: new if k == old else k for node, k in component.items()}
            yield a, b
