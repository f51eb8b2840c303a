"""Printed words on a wall, as a level camera sees them that looks straight at it, and a map with landmarks there."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from shared.geometry import FloatArray, transform
from station.model.navigation import Landmarks
from station.model.place_map import PlaceMap
from tests.support.stickers import FOCAL_PX, HEIGHT, WIDTH, looking_along_x, map_of_pictures

EVERY_M = 0.04  # landmarks on the wall


def plate_picture(text: str, scale: float = 1.0) -> bytes:
    """A JPEG of a white plate in the middle of a grey wall."""
    picture = np.full((HEIGHT, WIDTH, 3), 150, np.uint8)
    (w, h), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_DUPLEX, scale, 2)
    x, y = (WIDTH - w) // 2, (HEIGHT + h) // 2
    cv2.rectangle(picture, (x - 12, y - h - 12), (x + w + 12, y + 12), (245, 245, 245), -1)
    cv2.putText(picture, text, (x, y), cv2.FONT_HERSHEY_DUPLEX, scale, (20, 20, 20), 2, cv2.LINE_AA)
    return bytes(cv2.imencode(".jpg", cv2.GaussianBlur(picture, (3, 3), 0.6))[1])


def map_of_walls(pictures: list[bytes], at: list[tuple[float, float]], distance_m: list[float]) -> PlaceMap:
    """Pictures of a wall each, from (x, y) that far away, whose landmarks are 4 cm apart and seen in it alone."""
    poses = [looking_along_x(*xy) for xy in at]
    p: list[FloatArray] = []
    uv: list[FloatArray] = []
    for T, away in zip(poses, distance_m, strict=True):
        u, v = np.meshgrid(
            np.arange(0, WIDTH, FOCAL_PX * EVERY_M / away), np.arange(0, HEIGHT, FOCAL_PX * EVERY_M / away)
        )
        px = np.column_stack([u.ravel(), v.ravel()])
        ray = np.column_stack([(px - [319.5, 239.5]) / FOCAL_PX, np.ones(len(px))])
        p.append(transform(T, ray * away))
        uv.append(px)
    counts = [len(px) for px in uv]
    total = sum(counts)
    landmarks = Landmarks(
        np.concatenate(p),
        np.zeros((total, 3), np.uint8),
        np.zeros((total, 3, 3)),
        np.arange(total),
        np.repeat(np.arange(len(counts)), counts),
        np.concatenate(uv),
    )
    place_map = map_of_pictures(pictures, poses)
    return replace(place_map, navigation=replace(place_map.navigation, landmarks=landmarks))
