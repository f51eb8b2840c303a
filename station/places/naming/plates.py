"""Door plates and labels: printed words in the pictures of a map, each read once, from nearby."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import cv2
import numpy as np

from shared.geometry import FloatArray
from shared.room_sticker import MAX_READ
from shared.text import is_printable
from station.model.floor_plan import FloorPlan
from station.model.frames import ImageArray, decode_picture
from station.model.place_map import PlaceMap
from station.places.naming.close_views import close_views
from station.places.naming.facing import door_beside
from station.places.naming.room_words import RoomWords
from station.places.naming.sightings import MIN_LANDMARKS, PLAIN_TRUST, Eye, Sighting
from station.vision.printed import PrintedLine

MAX_PICTURES = 300  # 0.2 s each: a minute
SURE_SCORE = 0.97  # the least at which nearby plates were read: small print is misread below it, seldom above
MAX_WORDS = 4  # of a plate; more are a sentence

Reader = Callable[[ImageArray], list[PrintedLine]]


def find_plates(
    place_map: PlaceMap,
    plan: FloorPlan,
    words: RoomWords,
    read: Reader,
    stickers: Sequence[Sighting] = (),
    on_picture: Callable[[int, int], None] = lambda _n, _of: None,
) -> list[Sighting]:
    """Printed words that name a room and whose distance is known.

    Beside a door whatever reads like a plate does, elsewhere only a word for a room: a flat is full of brands and
    titles. The name printed on one of the `stickers` is that sticker's. `on_picture` hears how many of how many are
    read.
    """
    navigation = place_map.navigation
    if navigation.calibration.camera is None:
        return []
    eye = Eye(navigation)
    found: list[Sighting] = []
    views = close_views(navigation, MIN_LANDMARKS, MAX_PICTURES)
    for n, k in enumerate(views.tolist()):
        on_picture(n, len(views))
        try:
            bgr = decode_picture(navigation.keyframes.encoded[k], cv2.IMREAD_COLOR)
        except ValueError:
            continue  # a damaged picture is reported where maps are checked
        for line in read(bgr):
            name = plate_name(line, words)
            if name is None:
                continue
            at = eye.by_landmarks(k, line.corners_px, _plate_around(line.corners_px))
            if at is None:
                continue
            p_map, p_camera = eye.to_map(k, at[0])
            if words.number_of(name) is None and door_beside(plan, p_map) is None:
                continue
            seen = Sighting("door plate", name, PLAIN_TRUST, k, line.corners_px, p_map, p_camera, at[1])
            if not any(seen.is_near(sticker, plan.unit) for sticker in stickers):
                found.append(seen)
    return found


def plate_name(line: PrintedLine, words: RoomWords) -> str | None:
    """The name that a line of text gives, spelled as in the list of words where it is there.

    None: it reads like no plate, or not surely. What is in the list is confirmed by that.
    """
    word = words.spelled(line.text)
    is_sure = word is not None or line.score >= SURE_SCORE
    return (word or line.text) if is_sure and reads_like_a_plate(line.text) else None


def reads_like_a_plate(text: str) -> bool:
    """A few words or a number, as "Kitchen", "Room 2.14" and "2.14" are, and no address, price or sentence."""
    signs = text.replace(" ", "")
    usual = sum(c.isalnum() for c in signs)
    return (
        1 < len(text) <= MAX_READ
        and is_printable(text)
        and len(text.split()) <= MAX_WORDS
        and usual > len(signs) / 2
        and not any(c in text for c in ":=/@<>{}\\%€$£")
    )


def _plate_around(corners_px: FloatArray) -> FloatArray:
    """(4, 2) the line of text with its own height more on each side: the plate that it is printed on."""
    a, b, c, d = corners_px
    down = (d - a + c - b) / 2
    across = (b - a + c - d) / 2
    along = across / max(float(np.linalg.norm(across)), 1e-9) * float(np.linalg.norm(down))
    return np.array([a - down - along, b - down + along, c + down + along, d + down - along])
