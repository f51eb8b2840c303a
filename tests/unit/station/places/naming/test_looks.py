"""What the answers of three kinds of models say of rooms, and files that fit no model."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

import station.places.naming.looks
from shared.errors import DataError
from station.files.npz import Arrays
from station.places.naming.looks import labels_look, phrases_look
from station.places.naming.room_words import Nothing, RoomWord, RoomWords

WORDS = RoomWords(
    (
        RoomWord("Kitchen", looks_like=("oven", "sink", "a stove")),
        RoomWord("Bathroom", looks_like=("sink", "a tub")),
        RoomWord("Cellar"),
    ),
    Nothing(("a wall",)),
)


def names(words: RoomWords) -> list[str]:
    return [word.name for word in words.rooms]


def listed(tmp_path: Path, *labels: str) -> Path:
    path = tmp_path / "labels.txt"
    path.write_text("\n".join(labels) + "\n")
    return path


def embedded(tmp_path: Path, names: list[str], vectors: list[list[float]]) -> Path:
    path = tmp_path / "phrases.npz"
    np.savez(path, names=np.array(names), embeddings=np.array(vectors, dtype=np.float32))
    return path


def test_a_picture_is_what_the_phrases_nearest_to_it_are_phrases_of(tmp_path: Path) -> None:
    path = embedded(
        tmp_path,
        ["OVEN", "a stove", "a tub", "a wall", "else"],
        [[9, 1, 0], [9, -1, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]],
    )
    look, known = phrases_look(path, None, WORDS)
    assert names(known) == ["Kitchen", "Bathroom"] and known.nothing == WORDS.nothing
    p = look(np.array([2.0, 0.0, 0.0]))
    assert p[0] > 0.99 and len(p) == 3 and p.sum() == pytest.approx(1.0)
    assert look(np.array([0.0, 0.0, 0.1])).argmax() == 2
    # Cosines of 0.7071 and 0.7 apart by 0.0071, times CLIP's 100.
    near = look(np.array([0.7071, 0.7, 0.0]))
    assert near[0] / near[1] == pytest.approx(np.exp(100 * 0.0071), rel=0.05)
    with pytest.raises(DataError, match="4 numbers and the phrases have 3"):
        look(np.ones(4))


def test_rows_of_an_npy_are_named_by_a_list(tmp_path: Path) -> None:
    np.save(tmp_path / "phrases.npy", np.eye(2))
    look, _ = phrases_look(tmp_path / "phrases.npy", listed(tmp_path, "oven", "a tub"), WORDS)
    assert look(np.array([0.0, 1.0])).argmax() == 1
    with pytest.raises(DataError, match="has no names"):
        phrases_look(tmp_path / "phrases.npy", None, WORDS)


def test_classes_count_for_all_rooms_that_they_stand_for(tmp_path: Path) -> None:
    look, known = labels_look(listed(tmp_path, "oven", "Sink", "library"), WORDS)
    assert names(known) == ["Kitchen", "Bathroom"]
    np.testing.assert_allclose(look(np.array([0.5, 0.3, 0.2])), [0.65, 0.15, 0.2])  # probabilities
    odds = np.exp([3.0, 1.0, -1.0])
    np.testing.assert_allclose(look(np.array([3.0, 1.0, -1.0]))[0], (odds[0] + odds[1] / 2) / odds.sum())  # logits


@pytest.mark.parametrize("is_turned", [False, True])
def test_one_thing_that_is_surely_seen_speaks_for_its_room(tmp_path: Path, is_turned: bool) -> None:
    look, _ = labels_look(listed(tmp_path, "oven", "sink", "dog"), WORDS)
    boxes = np.zeros((7, 9))
    boxes[:4] = 300.0
    boxes[4, 5], boxes[4, 6], boxes[6, 1] = 0.8, 0.3, 0.9  # an oven, and a dog, which is in no room
    p = look(boxes.T if is_turned else boxes)
    np.testing.assert_allclose(p, [0.8, 0.0, 0.2])
    assert look(np.zeros((7, 9)))[-1] == 1.0
    boxes[5, 2] = 0.9  # a sink: of both, but there is an oven beside it
    both = look(boxes.T if is_turned else boxes)
    assert both[0] > both[1] > 0.2 and both.sum() == pytest.approx(1.0)
    boxes[5, 2] = 7.0
    with pytest.raises(DataError, match="not between 0 and 1"):
        look(boxes)


@pytest.mark.parametrize("shape", [(4,), (6, 9), (2, 7, 9)])
def test_answers_that_do_not_fit_the_labels_are_refused(tmp_path: Path, shape: tuple[int, ...]) -> None:
    look, _ = labels_look(listed(tmp_path, "oven", "sink", "dog"), WORDS)
    with pytest.raises(DataError, match="do not fit 3 labels"):
        look(np.zeros(shape))


def test_files_that_cannot_be_used_are_refused_in_a_sentence(tmp_path: Path) -> None:
    (tmp_path / "no.npz").write_bytes(b"no zip file at all")
    (tmp_path / "no.npy").write_bytes(
        b"\x93NUMPY\x01\x00\x76\x00{'descr': '<f8', 'fortran_order': False, 'shape': (99,)}"
    )
    np.savez(tmp_path / "other.npz", vectors=np.eye(2))
    np.savez(tmp_path / "pickled.npz", names=np.array(["a", None], dtype=object), embeddings=np.eye(2))
    np.savez(tmp_path / "whole.npz", names=np.array(["oven", "sink"]), embeddings=np.eye(2, dtype=int))
    np.savez(tmp_path / "numbers.npz", names=np.arange(2), embeddings=np.eye(2))
    np.savez(tmp_path / "fewer.npz", names=np.array(["oven"]), embeddings=np.eye(2))
    np.savez(tmp_path / "zero.npz", names=np.array(["oven", "sink"]), embeddings=np.zeros((2, 2)))
    np.savez(tmp_path / "wide.npz", names=np.array(["oven"]), embeddings=np.ones((1, 20_000), np.float16))
    np.savez(tmp_path / "foreign.npz", names=np.array(["dog", "cat"]), embeddings=np.eye(2))
    labels = listed(tmp_path, "oven", "sink")
    beyond = np.frombuffer(np.array([0x110000, 65], "<u4").tobytes(), "<U1")
    np.savez(tmp_path / "beyond.npz", names=beyond, embeddings=np.eye(2))
    os.mkfifo(tmp_path / "pipe.npz")
    for name, words in (
        ("none.npz", "cannot be read"),
        ("beyond.npz", "no character"),
        ("pipe.npz", "it is a pipe"),
        ("no.npz", "another kind of file"),
        ("other.npz", "another kind of file"),
        ("pickled.npz", "another kind of file"),
        ("whole.npz", "no floating-point numbers"),
        ("numbers.npz", "no row of texts"),
        ("fewer.npz", "one row a name"),
        ("zero.npz", "without direction"),
        ("wide.npz", "20000 numbers"),
        ("foreign.npz", "nothing that a room word looks like"),
    ):
        with pytest.raises(DataError, match=words) as caught:
            phrases_look(tmp_path / name, None, WORDS)
        assert str(tmp_path / name) in str(caught.value)
    with pytest.raises(DataError, match="another kind of file"):
        phrases_look(tmp_path / "no.npy", labels, WORDS)


def test_embeddings_that_are_small_only_while_packed_are_refused_before_they_are_unpacked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "packed.npz"
    np.savez_compressed(path, names=np.array(["oven"]), embeddings=np.ones((1, 10_000)))
    monkeypatch.setattr(station.places.naming.looks, "MAX_EMBEDDING_BYTES", 2 * path.stat().st_size)
    monkeypatch.setattr(Arrays, "read", lambda *_: pytest.fail("it was unpacked"))
    with pytest.raises(DataError, match="its embeddings have more than"):
        phrases_look(path, None, WORDS)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "has 0 labels"),
        (b"oven\n\nsink\n", "label 2 needs"),
        (b"\xff\xff", "is no text"),
        (b"a\n" * 30_001, "has 30001 labels"),
        (b"a" * 1_000_001, "more than"),
        (b"dog\ncat\n", "nothing that a room word looks like"),
    ],
)
def test_lists_of_labels_that_cannot_be_used_are_refused(tmp_path: Path, content: bytes, words: str) -> None:
    (tmp_path / "labels.txt").write_bytes(content)
    with pytest.raises(DataError, match=words):
        labels_look(tmp_path / "labels.txt", WORDS)


@pytest.mark.timeout(20)
def test_what_gives_bytes_without_end_is_no_list_and_no_embeddings() -> None:
    for look in (lambda path: labels_look(path, WORDS), lambda path: phrases_look(path, None, WORDS)):
        with pytest.raises(DataError, match="it is a device"):
            look(Path("/dev/zero"))


def test_a_list_may_begin_with_the_mark_of_some_editors(tmp_path: Path) -> None:
    (tmp_path / "labels.txt").write_text("oven\nsink\n", encoding="utf-8-sig")
    look, _ = labels_look(tmp_path / "labels.txt", WORDS)
    assert look(np.array([1.0, 0.0]))[0] == 1.0
