"""Pictures of a map and its places, as files for a page."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from station.errors import Unknown
from station.model.place_map import Place, PlaceMap
from station.places.making.place_images import images_of_place

WHITE_DEVIATION = 100.0  # grey levels, as in the reports: images of one place seldom differ by more


def mean_image(place_map: PlaceMap, place: Place) -> bytes:
    """A place's mean image as JPEG (eq. 4.2). Raises Unknown when it has no images."""
    return _as_jpeg(images_of_place(place_map, place).mean_bgr, place)


def deviation_image(place_map: PlaceMap, place: Place) -> bytes:
    """How much the brightness of a place's images differs, as JPEG. Raises Unknown when it has no images."""
    deviation = images_of_place(place_map, place).deviation
    return _as_jpeg(np.clip(deviation * (255.0 / WHITE_DEVIATION), 0, 255).astype(np.uint8), place)


def _as_jpeg(pixels: npt.NDArray[np.uint8], place: Place) -> bytes:
    if pixels.size:
        is_done, encoded = cv2.imencode(".jpg", pixels)
        if is_done:
            return encoded.tobytes()
    raise Unknown(f"{place.name} has no readable images")


def keyframe_image(place_map: PlaceMap, keyframe: int) -> bytes:
    """A keyframe's image file. Raises Unknown."""
    encoded = place_map.navigation.keyframes.encoded
    if not 0 <= keyframe < len(encoded) or not encoded[keyframe]:
        raise Unknown(f"map {place_map.id} has no image {keyframe}")
    return encoded[keyframe]
