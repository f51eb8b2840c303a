"""A map of two rooms whose pictures have one colour each: what a network of the tests tells rooms by."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from station.model.navigation import Landmarks
from station.model.place_map import Place, PlaceMap
from tests.support.plans import two_rooms
from tests.support.stickers import looking_along_x, map_of_pictures

RED, GREEN, BLUE, GREY = (220, 30, 30), (30, 220, 30), (30, 30, 220), (120, 120, 120)
Colour = tuple[int, int, int]  # red, green, blue


def coloured_picture(colour: Colour) -> bytes:
    picture = np.full((48, 64, 3), colour[::-1], np.uint8)
    return bytes(cv2.imencode(".png", picture)[1])


def coloured_rooms(living_room: list[list[Colour]], other: list[list[Colour]]) -> PlaceMap:
    """A list of views for each place of the living room and of "Room 2". Each view shows one landmark of its place."""
    pictures: list[bytes] = []
    places: list[Place] = []
    poses, p_world, seen = [], [], []
    room_of_place = {}
    for room, x, of_room in (("room-l", 0.0, living_room), ("room-k", 4.0, other)):
        for views in of_room:
            number = len(places)
            first = len(pictures)
            for colour in views:
                pictures.append(coloured_picture(colour))
                poses.append(looking_along_x(x, 0.1 * number))
                seen.append(number)
            p = np.array([x + 1.0, 0.1 * number, 0.3])
            p_world.append(p)
            views_of_place = np.arange(first, len(pictures))
            places.append(
                Place(f"p{number}", f"Place {number}", p, 0.1, np.array([number]), views_of_place, first, 1.0)
            )
            room_of_place[f"p{number}"] = room
    landmarks = Landmarks(
        np.array(p_world),
        np.zeros((len(places), 3), np.uint8),
        np.zeros((len(places), 3, 3)),
        np.array(seen),
        np.arange(len(seen)),
        np.tile([32.0, 24.0], (len(seen), 1)),
    )
    place_map = map_of_pictures(pictures, poses)
    plan = replace(two_rooms(), room_of_place=room_of_place)
    navigation = replace(place_map.navigation, landmarks=landmarks)
    return replace(place_map, navigation=navigation, places=tuple(places), plan=plan)
