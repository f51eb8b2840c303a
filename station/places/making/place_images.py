"""What a place looks like: representative image, mean image and brightness deviation (thesis eq. 4.2)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from shared.geometry import FloatArray, IntArray
from station.model.frames import decode_picture
from station.model.navigation import Keyframes, Landmarks
from station.model.place_map import Place, PlaceMap

WIDTH = 160  # px; mean and deviation are blurred by nature, and memory is (places x pixels)
MAX_IMAGES = 64  # per place, evenly spread: more do not change a mean image
MAX_KEPT = 500  # small images in memory: 30 MB
MIN_SHARE = 0.5  # of the keyframe that sees most of a place's landmarks; below it the place is at the image's edge


@dataclass(frozen=True, slots=True, eq=False)
class PlaceImages:
    keyframe_index: IntArray  # (k,) the keyframes it was made of
    representative_keyframe: int  # the image nearest to the mean image; -1 without a readable image
    mean_bgr: npt.NDArray[np.uint8]  # (H, W, 3); (0, 0, 3) without images
    deviation: npt.NDArray[np.uint8]  # (H, W) standard deviation of the brightness
    mean_deviation: float  # its average, grey levels: how alike the images are


def observing_keyframes(landmarks: Landmarks, members: IntArray) -> tuple[IntArray, IntArray]:
    """Keyframes that saw the member landmarks, most observations first, and how many of them each saw."""
    is_member = np.zeros(len(landmarks), dtype=bool)
    is_member[members] = True
    seen = landmarks.observed_keyframe[is_member[landmarks.observed_landmark]]
    keyframe, count = np.unique(seen, return_counts=True)
    order = np.argsort(-count, kind="stable")
    return keyframe[order].astype(np.int64), count[order].astype(np.int64)


def generating_keyframes(landmarks: Landmarks, members: IntArray) -> IntArray:
    """Keyframes the member landmarks were first seen from: the images a place holds in the thesis (fig. 4.5)."""
    first = np.unique(landmarks.first_keyframe()[members])
    return first[first >= 0]


def keyframes_of_place(landmarks: Landmarks, members: IntArray, *, thesis: bool) -> IntArray:
    """(k,) at most MAX_IMAGES keyframes whose images stand for a place, in time order."""
    if thesis:
        chosen = generating_keyframes(landmarks, members)
    else:
        keyframe, count = observing_keyframes(landmarks, members)
        chosen = np.sort(keyframe[count >= MIN_SHARE * count.max(initial=0)])
    if len(chosen) > MAX_IMAGES:
        chosen = chosen[np.linspace(0, len(chosen) - 1, MAX_IMAGES).round().astype(np.int64)]
    return chosen


def images_of_place(place_map: PlaceMap, place: Place) -> PlaceImages:
    """What a place of a map looks like, made from the images that its representative one was chosen from."""
    chosen = {place.id: keyframes_shown(place_map, place)}
    return make_place_images(place_map.navigation.keyframes, chosen)[place.id]


def keyframes_shown(place_map: PlaceMap, place: Place) -> IntArray:
    """(k,) the keyframes that show what a place of a map looks like."""
    thesis = place_map.config.get("mode") == "thesis"
    return keyframes_of_place(place_map.navigation.landmarks, place.landmark_index, thesis=thesis)


def make_place_images(keyframes: Keyframes, chosen: Mapping[str, IntArray]) -> dict[str, PlaceImages]:
    """Images of every place. Few images are kept for the second look at them; of more, each is decoded twice.

    `chosen`: the keyframes (k,) that each place is seen in.

    Images that cannot be decoded are left out; a damaged file must not cost a map.
    """
    wanted = sorted({int(k) for index in chosen.values() for k in index if k < len(keyframes.encoded)})
    places_of = {k: [place for place, index in chosen.items() if k in index] for k in wanted}
    shape = _common_shape(keyframes.encoded, wanted)
    total = {place: np.zeros((*shape, 3)) for place in chosen}
    squares = {place: np.zeros(shape) for place in chosen}
    count = dict.fromkeys(chosen, 0)
    kept: dict[int, npt.NDArray[np.uint8]] = {}
    for k in wanted:
        small = _small_image(keyframes.encoded[k], shape)
        if small is None:
            continue
        if len(kept) < MAX_KEPT:
            kept[k] = small
        image = small.astype(np.float64)
        for place in places_of[k]:
            total[place] += image
            squares[place] += _brightness(image) ** 2
            count[place] += 1
    mean = {place: total[place] / max(count[place], 1) for place in chosen}
    nearest: dict[str, tuple[float, int]] = {}
    for k in wanted:
        small = kept[k] if k in kept else _small_image(keyframes.encoded[k], shape)
        if small is None:
            continue
        image = small.astype(np.float64)
        for place in places_of[k]:
            difference = float(np.abs(image - mean[place]).mean())  # eq. 4.2
            nearest[place] = min(nearest.get(place, (np.inf, -1)), (difference, k))
    return {
        place: _images(chosen[place], nearest.get(place, (0.0, -1))[1], mean[place], squares[place], count[place])
        for place in chosen
    }


def _images(index: IntArray, representative: int, mean: FloatArray, squares: FloatArray, count: int) -> PlaceImages:
    if not count:
        return PlaceImages(index, -1, np.zeros((0, 0, 3), np.uint8), np.zeros((0, 0), np.uint8), 0.0)
    deviation = np.sqrt(np.maximum(squares / count - _brightness(mean) ** 2, 0.0))
    return PlaceImages(
        keyframe_index=index,
        representative_keyframe=representative,
        mean_bgr=np.clip(mean.round(), 0, 255).astype(np.uint8),
        deviation=np.clip(deviation.round(), 0, 255).astype(np.uint8),
        mean_deviation=float(deviation.mean()),
    )


def _brightness(image: FloatArray) -> FloatArray:
    return image @ np.array([0.114, 0.587, 0.299])  # BGR, ITU-R BT.601


def _common_shape(encoded: Sequence[bytes], wanted: Sequence[int]) -> tuple[int, int]:
    for k in wanted:
        image = _decode(encoded[k])
        if image is not None:
            height, width = image.shape[:2]
            return max(1, round(WIDTH * height / width)), WIDTH
    return 1, 1


def _small_image(encoded: bytes, shape: tuple[int, int]) -> npt.NDArray[np.uint8] | None:
    image = _decode(encoded)
    if image is None:
        return None
    return np.asarray(cv2.resize(image, (shape[1], shape[0]), interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _decode(encoded: bytes) -> npt.NDArray[np.uint8] | None:
    try:  # half size is enough, and a JPEG decodes to it in a third of the time
        return decode_picture(encoded, cv2.IMREAD_REDUCED_COLOR_2)
    except ValueError:
        return None
