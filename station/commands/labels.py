"""`station labels`: names for a map's rooms by what a model of the user's sees in its pictures."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import cv2
import numpy as np
import typer

from shared.errors import DataError
from shared.text import printable
from station.commands.map_store import MapArgument, is_folder, open_map, open_store
from station.commands.options import Config, Data, Json
from station.commands.progress import working
from station.files.unwritable import cannot_write, why_unwritable
from station.library.maps import MAX_WHY
from station.maps.folder import load_map_folder, save_map_folder
from station.model.floor_plan import NameSuggestion
from station.model.frames import decode_picture
from station.model.place_map import PlaceMap
from station.places.making.graph import to_graphml
from station.places.naming.looks import Look, labels_look, phrases_look
from station.places.naming.room_words import DEFAULT, load_room_words
from station.places.naming.votes import Votes, suggestions_by_votes
from station.places.rooms.edits import require_plan
from station.places.rooms.planning import with_suggestions_of
from station.vision.image_model import ImageModel, Pixels


def register(app: typer.Typer) -> None:
    app.command()(labels)


def labels(
    which: MapArgument,
    model: Annotated[
        Path, typer.Option("--model", help="An ONNX file: one picture in. Run none that you do not trust.")
    ],
    embeddings: Annotated[
        Path | None,
        typer.Option(help="Of phrases, by the text encoder of a model like CLIP: .npz with `names` and `embeddings`."),
    ] = None,
    label_list: Annotated[
        Path | None,
        typer.Option("--labels", help="Of a classifier or detector, in its order, one a line; or of a .npy's rows."),
    ] = None,
    words: Annotated[
        Path, typer.Option(help="What rooms are called and look like; copy the default and edit.")
    ] = DEFAULT,
    pixels: Annotated[
        Pixels | None,
        typer.Option(help="What the model takes: 0 to 1, or normalised as CLIP or ImageNet; clip with --embeddings."),
    ] = None,
    size: Annotated[
        int | None, typer.Option(help="Of the square it sees, px, where the file leaves that open.")
    ] = None,
    pictures: Annotated[int, typer.Option(min=1, help="At most so many of the map, evenly spread.")] = 500,
    data: Data = None,
    config: Config = None,
    as_json: Json = False,
) -> None:
    """Suggest names for a map's rooms by a model of yours: each view votes. Nothing is named until you accept it.

    The suggestions of an earlier run are replaced. A running station shows them once the map is chosen again.
    """
    place_map = open_map(which, data, config)
    require_plan(place_map)
    _require_writable(which, data, config)
    room_words = load_room_words(words)
    if embeddings is not None:
        look, seen = phrases_look(embeddings, label_list, room_words)
    elif label_list is not None:
        look, seen = labels_look(label_list, room_words)
    else:
        raise DataError("give --embeddings for a model like CLIP, or --labels for a classifier or detector")
    network = ImageModel(model, pixels or ("clip" if embeddings is not None else "unit"), size)
    votes, took_ms = _look_at(place_map, network, look, pictures)
    called_model = printable(model.name)

    def with_names(now: PlaceMap) -> PlaceMap:
        """The map as it is by now: people may have named rooms while the model looked."""
        if now.navigation.keyframes.encoded != place_map.navigation.keyframes.encoded:
            raise DataError(f"{which} was built anew while the model looked at its pictures; run again")
        found = suggestions_by_votes(now, require_plan(now), votes, seen, called_model)
        return with_suggestions_of(now, "model", found)

    place_map = _edit(which, data, config, with_names, f"{called_model} looked at the rooms"[:MAX_WHY])
    found = [s for s in place_map.suggestions if s.source == "model"]
    unseen = [word.name for word in room_words.rooms if word not in seen.rooms]
    names = [*(word.name for word in seen.rooms), "none"]
    latency = {"median": round(float(np.median(took_ms)), 3), "p95": round(float(np.percentile(took_ms, 95)), 3)}
    if as_json:
        print(json.dumps(_summary(place_map, votes, names, found, unseen, latency)))
        return
    called = {room.id: room.name for room in require_plan(place_map).rooms}
    for s in found:
        print(f"{called[s.room]}: {s.name}? ({s.confidence:.0%}) {s.reason}")
    if not found:
        print("No suggestion.")
    if unseen:
        print(f"{model.name} cannot recognise: {', '.join(unseen)} (no label for them)")
    print(
        f"{len(took_ms)} pictures, each {latency['median']:.0f} ms of one core (median; "
        f"95 %: {latency['p95']:.0f} ms); click into a room on the page to use a name"
    )


def _look_at(place_map: PlaceMap, network: ImageModel, look: Look, most: int) -> tuple[Votes, list[float]]:
    """What the model says of evenly spread pictures, and how long each took, ms."""
    encoded = place_map.navigation.keyframes.encoded
    chosen, votes, took_ms = [], [], []
    with working(f"{network.path.name} looks at pictures") as bar:
        step = max(1, -(-len(encoded) // most))
        indices = range(0, len(encoded), step)
        bar.step(f"{network.path.name} looks at pictures", len(indices))
        for k in indices:
            bar.advance()
            try:
                bgr = decode_picture(encoded[k], cv2.IMREAD_COLOR)
            except ValueError:
                continue  # a damaged picture is reported where maps are checked
            begin = time.perf_counter()
            answer = network(bgr)
            took_ms.append((time.perf_counter() - begin) * 1e3)
            votes.append(look(answer))
            chosen.append(k)
    if not chosen:
        raise DataError(f'map "{place_map.name}" has no picture that can be looked at')
    return Votes(np.array(chosen, dtype=np.int64), np.array(votes)), took_ms


def _require_writable(which: str, data: Path | None, config: Path | None) -> None:
    """Before long work whose result is to be kept there. Raises DataError."""
    if not is_folder(which):
        open_store(data, config).require_writable()
    elif told := why_unwritable(Path(which).absolute().parent):  # the folder is replaced as a whole
        raise cannot_write(Path(which), told)


def _edit(
    which: str, data: Path | None, config: Path | None, change: Callable[[PlaceMap], PlaceMap], why: str
) -> PlaceMap:
    """Change the map as it is by now, and return it."""
    if not is_folder(which):
        return open_store(data, config).edit(which, change, why)[0]
    place_map = change(load_map_folder(Path(which)))
    save_map_folder(place_map, Path(which), {"graph.graphml": to_graphml(place_map)})
    return place_map


def _summary(
    place_map: PlaceMap,
    votes: Votes,
    names: list[str],
    found: list[NameSuggestion],
    unseen: list[str],
    latency: dict[str, float],
) -> dict[str, Any]:
    _, of_places = votes.of_places(place_map)
    return {
        "suggestions": [
            {
                "room": s.room,
                "name": s.name,
                "confidence": round(s.confidence, 3),
                "reason": s.reason,
                "picture": s.keyframe_index,
            }
            for s in found
        ],
        "places": {
            place.id: {name: round(float(p), 3) for name, p in zip(names, vote, strict=True)}
            for place, vote in zip(place_map.places, of_places, strict=True)
        },
        "unseen": unseen,
        "pictures": len(votes.p),
        "latency_ms": latency,
    }
