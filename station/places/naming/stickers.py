"""Stickers with a code, seen in the keyframes of a map."""

from __future__ import annotations

import cv2
import numpy as np

from shared.geometry import FloatArray
from shared.room_sticker import CODE_SIDE_M, is_ours, room_named_by
from station.model.floor_plan import FloorPlan, NameSuggestion
from station.model.frames import decode_picture
from station.model.place_map import PlaceMap
from station.places.naming.sightings import PLAIN_TRUST, Eye, Sighting, suggestions
from station.vision.codes import read_codes
from station.vision.lens import Lens

MAX_PICTURES = 2000  # evenly spread over a larger map: 10 ms each
OWN_TRUST = 0.99  # of a code that says it names a room
SIZE_SIGMA = 0.06  # one sigma of a distance by printed size: what printers shrink a page (3 to 6 %), half a pixel of 60


def stickers_in(place_map: PlaceMap, plan: FloorPlan) -> tuple[NameSuggestion, ...]:
    """Names that stickers in the map's pictures give to rooms of the plan."""
    return suggestions(find_stickers(place_map, plan.unit), plan)


def find_stickers(place_map: PlaceMap, unit: float) -> list[Sighting]:
    """All codes in the keyframes that name a room and whose distance is known. `unit`: map units per metre."""
    navigation = place_map.navigation
    keyframes = navigation.keyframes
    if navigation.calibration.camera is None:
        return []
    eye = Eye(navigation)
    found = []
    step = max(1, -(-len(keyframes) // MAX_PICTURES))
    for k in range(0, len(keyframes), step):
        try:
            grey = decode_picture(keyframes.encoded[k], cv2.IMREAD_GRAYSCALE)
        except ValueError:
            continue  # a damaged picture is reported where maps are checked
        for code in read_codes(grey):
            name = room_named_by(code.text)
            if name is None:
                continue
            trust = OWN_TRUST if is_ours(code.text) else PLAIN_TRUST
            at = eye.by_landmarks(k, code.corners_px, code.corners_px)
            if at is None and navigation.is_metric and is_ours(code.text):
                at = _by_size(eye.lens, code.corners_px, CODE_SIDE_M * unit)
            if at is not None:
                p_map, p_camera = eye.to_map(k, at[0])
                found.append(Sighting("sticker", name, trust, k, code.corners_px, p_map, p_camera, at[1]))
    return found


def _by_size(lens: Lens, corners_px: FloatArray, side: float) -> tuple[FloatArray, float] | None:
    """Where a code of this size is (3,), camera frame, and the sigma of its distance."""
    square = np.array([[-1, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]]) * (side / 2)
    ok, _, t = cv2.solvePnP(square, lens.unproject(corners_px), np.eye(3), None, flags=cv2.SOLVEPNP_IPPE_SQUARE)
    if not ok or t[2, 0] <= 0:
        return None
    return np.asarray(t, dtype=np.float64).reshape(3), SIZE_SIGMA * float(np.linalg.norm(t))
