"""`station labels`: a model's votes become suggestions in the map; what cannot be used leaves it as it was."""

from __future__ import annotations

import errno
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from station.commands import labels
from station.main import app
from station.maps import store as maps_store
from station.maps.folder import load_map_folder, save_map_folder
from station.maps.store import MapStore
from station.places.rooms.edits import with_room_renamed
from tests.support.coloured_rooms import BLUE, GREEN, GREY, RED, Colour, coloured_rooms
from tests.support.onnx_models import (
    save_colour_classifier,
    save_colour_detector,
    save_colour_embedding,
)
from tests.support.places import make_map

pytestmark = pytest.mark.computing

FLAT = [[BLUE, BLUE]], [[RED, RED, GREY], [RED], [GREEN]]  # of the other room most places look red


def flat(tmp_path: Path) -> Path:
    save_map_folder(coloured_rooms(*FLAT), tmp_path / "map")
    return tmp_path / "map"


def phrases(tmp_path: Path) -> Path:
    """Red is a stove, green a tub, and blue, as one sees in every flat, a living room."""
    path = tmp_path / "phrases.npz"
    names = ["a photo of a kitchen", "a photo of a bathroom", "living room", "a photo of a bare wall"]
    np.savez(path, names=np.array(names), embeddings=np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]], float))
    return path


def run(*words: str | Path) -> Result:
    return CliRunner().invoke(app, ["labels", *map(str, words)])


def test_a_model_like_clip_suggests_what_most_places_look_like(tmp_path: Path) -> None:
    model, folder = save_colour_embedding(tmp_path / "colours.onnx"), flat(tmp_path)
    done = run(folder, "--model", model, "--embeddings", phrases(tmp_path), "--pixels", "unit")
    assert done.exit_code == 0, done.output
    assert "Room 2: Kitchen? (" in done.stdout and "7 pictures, each" in done.stdout and "Bedroom" in done.stdout
    (found,) = load_map_folder(folder).suggestions
    assert (found.room, found.name, found.source) == ("room-k", "Kitchen", "model")
    assert 0.3 < found.confidence < 0.65 and found.keyframe_index in (2, 3, 5)
    plan = load_map_folder(folder).plan
    assert plan is not None and plan.rooms[1].name == "Room 2"  # nobody accepted it


@pytest.mark.parametrize("kind", ["classifier", "detector"])
def test_classifiers_and_detectors_vote_too_and_again_replaces_what_they_said(tmp_path: Path, kind: str) -> None:
    if kind == "classifier":
        model = save_colour_classifier(tmp_path / "c.onnx", [[9, 0, 0], [0, 9, 0], [0, 0, 9]])
    else:
        model = save_colour_detector(tmp_path / "d.onnx")
    labels, folder = tmp_path / "labels.txt", flat(tmp_path)
    labels.write_text("oven\nbathtub\ncouch\n")
    for _ in range(2):
        done = run(folder, "--model", model, "--labels", labels, "--json")
        assert done.exit_code == 0, done.output
    told = json.loads(done.stdout.splitlines()[-1])
    assert [(s["room"], s["name"]) for s in told["suggestions"]] == [("room-k", "Kitchen")]
    assert told["places"]["p0"]["Living room"] > 0.5 and told["places"]["p3"]["Bathroom"] > 0.5
    assert told["pictures"] == 7 and told["latency_ms"]["median"] > 0 and "Office" in told["unseen"]
    assert set(told["places"]["p0"]) == {"Kitchen", "Living room", "Bathroom", "none"}
    assert len(load_map_folder(folder).suggestions) == 1


def test_a_map_that_the_station_keeps_gets_them_as_a_change_that_can_be_undone(tmp_path: Path) -> None:
    store = MapStore(tmp_path / "data" / "maps")
    store.save(coloured_rooms(*FLAT))
    model = save_colour_embedding(tmp_path / "colours.onnx")
    done = run(
        "map-1", "--data", tmp_path / "data", "--model", model, "--embeddings", phrases(tmp_path), "--pixels", "unit"
    )
    assert done.exit_code == 0, done.output
    assert [s.name for s in store.load("map-1").suggestions] == ["Kitchen"]
    assert store.history("map-1")[0].why == "colours.onnx looked at the rooms"
    store.undo("map-1")
    assert store.load("map-1").suggestions == ()


def test_a_list_of_words_of_ones_own_says_what_is_looked_for(tmp_path: Path) -> None:
    words = tmp_path / "words.toml"
    words.write_text('[[rooms]]\nname = "Oven museum"\nlooks_like = ["a photo of a kitchen"]\n')
    model, folder = save_colour_embedding(tmp_path / "colours.onnx"), flat(tmp_path)
    options = "--embeddings", phrases(tmp_path), "--pixels", "unit", "--words", words
    assert run(folder, "--model", model, *options).exit_code == 0
    assert {s.name for s in load_map_folder(folder).suggestions} == {"Oven museum"}


def detector(tmp_path: Path) -> tuple[str | Path, ...]:
    """Options of one that sees ovens, tubs and couches."""
    labels = tmp_path / "labels.txt"
    labels.write_text("oven\nbathtub\ncouch\n")
    return "--model", save_colour_detector(tmp_path / "d.onnx"), "--labels", labels


def test_a_room_of_which_the_model_has_no_word_says_nothing_of_the_model(tmp_path: Path) -> None:
    options = detector(tmp_path)
    confidences = []
    for name in ("", "Hall"):
        flat = coloured_rooms(*FLAT)
        save_map_folder(with_room_renamed(flat, "room-l", name) if name else flat, tmp_path / "map")
        done = run(tmp_path / "map", *options)
        assert done.exit_code == 0, done.output
        assert "d.onnx cannot recognise: Bedroom, " in done.stdout and "Hall" in done.stdout
        by_room = {s.room: s for s in load_map_folder(tmp_path / "map").suggestions}
        assert by_room["room-k"].name == "Kitchen" and "Nobody knows yet" in by_room["room-k"].reason
        confidences.append(by_room["room-k"].confidence)
    assert confidences[0] == confidences[1]


def while_it_looks(monkeypatch: pytest.MonkeyPatch, happens: Callable[[], object]) -> None:
    look_at = labels._look_at

    def look(*arguments: Any) -> Any:
        found = look_at(*arguments)
        happens()
        return found

    monkeypatch.setattr(labels, "_look_at", look)


FEWER = [[BLUE]], [[RED]]
AS_MANY = [[GREEN, GREEN]], [[RED, RED, GREY], [RED], [GREEN]]


@pytest.mark.parametrize("other", [FEWER, AS_MANY])
def test_a_map_that_is_built_anew_while_the_model_looks_is_left_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, other: tuple[list[list[Colour]], list[list[Colour]]]
) -> None:
    store, folder, options = MapStore(tmp_path / "data" / "maps"), flat(tmp_path), detector(tmp_path)
    store.save(coloured_rooms(*FLAT))

    def build_anew() -> None:
        store.save(coloured_rooms(*other))
        save_map_folder(coloured_rooms(*other), folder)

    while_it_looks(monkeypatch, build_anew)
    for which in ((folder,), ("map-1", "--data", tmp_path / "data")):
        store.save(coloured_rooms(*FLAT))
        save_map_folder(coloured_rooms(*FLAT), folder)
        done = run(*which, *options)
        assert "was built anew" in str(done.exception) and "run again" in str(done.exception)
    for place_map in (load_map_folder(folder), store.load("map-1")):
        assert place_map.suggestions == () and len(place_map.places) == len([*other[0], *other[1]])


def test_what_people_do_to_a_folder_while_the_model_looks_stays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, options = flat(tmp_path), detector(tmp_path)
    (folder / "notes").mkdir()
    (folder / "notes" / "mine.txt").write_text("my own")

    def name_the_room() -> None:
        save_map_folder(with_room_renamed(load_map_folder(folder), "room-k", "Anna"), folder)

    while_it_looks(monkeypatch, name_the_room)
    done = run(folder, *options)
    assert done.exit_code == 0 and "No suggestion." in done.stdout, done.output
    place_map = load_map_folder(folder)
    assert place_map.plan_edits.names == {"room-k": "Anna"} and place_map.suggestions == ()
    assert (folder / "notes" / "mine.txt").read_text() == "my own"


def test_whether_it_can_be_kept_is_asked_before_the_work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store, folder, (_, *options) = MapStore(tmp_path / "data" / "maps"), flat(tmp_path), detector(tmp_path)
    store.save(coloured_rooms(*FLAT))
    for module in (labels, maps_store):
        monkeypatch.setattr(module, "why_unwritable", lambda _: OSError(errno.EROFS, "Read-only file system"))
    for which in ((folder,), ("map-1", "--data", tmp_path / "data")):
        done = run(*which, "--model", tmp_path / "none.onnx", *options[1:])
        assert "Read-only file system" in str(done.exception), done.exception


def test_what_cannot_be_used_is_refused_in_a_sentence_and_changes_nothing(tmp_path: Path) -> None:
    folder, labels = flat(tmp_path), tmp_path / "labels.txt"
    labels.write_text("oven\n")
    text = tmp_path / "text.onnx"
    text.write_text("no model")
    embedding = save_colour_embedding(tmp_path / "colours.onnx")
    save_map_folder(make_map(), tmp_path / "planless")
    four = tmp_path / "four.npz"
    np.savez(four, names=np.array(["kitchen"]), embeddings=np.ones((1, 4)))
    before = (folder / "map.json").read_bytes()
    for options, words in (
        ((folder, "--model", embedding), "--embeddings for a model like CLIP"),
        ((folder, "--model", text, "--labels", labels), "no ONNX file"),
        ((folder, "--model", tmp_path / "none.onnx", "--labels", labels), "is no file"),
        ((folder, "--model", embedding, "--labels", labels), "do not fit 1 labels"),
        ((folder, "--model", embedding, "--labels", tmp_path / "none.txt"), "cannot be read"),
        ((folder, "--model", embedding, "--embeddings", four), "text encoder of this very model"),
        ((folder, "--model", embedding, "--labels", labels, "--words", labels), "no TOML file"),
        ((tmp_path / "planless", "--model", embedding, "--labels", labels), "no floor plan"),
        ((tmp_path / "none", "--model", embedding, "--labels", labels), "is no folder"),
    ):
        done = run(*options)
        assert done.exit_code != 0 and words in str(done.exception), (words, done.exception)
    assert (folder / "map.json").read_bytes() == before
