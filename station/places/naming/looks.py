"""What a model's answer to one picture says: for each room word, and last for none of them, how probable it is.

Three kinds of models, told apart by what is given beside them: embeddings of phrases (as CLIP has), or a list of labels
with probabilities (a classifier) or boxes (a detector).
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from shared.bounded import Refused, open_file, read_text
from shared.errors import DataError
from shared.geometry import FloatArray
from shared.text import is_printable
from station.files.npz import UNREADABLE, open_arrays, read_array
from station.places.naming.room_words import MAX_PHRASE, RoomWords

MAX_LIST_BYTES, MAX_EMBEDDING_BYTES = 1_000_000, 200_000_000
MAX_DIMENSIONS = 16_384  # of an embedding: the widest encoders give some 4,000
MAX_LABELS = 30_000  # the largest lists of classes have 22,000
CLIP_SCALE = 100.0  # of cosines, before the softmax: what CLIP and its kin have learned (Radford et al., 2021, 2.5)
BOX = 4  # numbers of a box before its scores: YOLOv8 and what came after it

Look = Callable[[FloatArray], FloatArray]  # a model's answer to one picture -> (W + 1,), sums to 1


@dataclass(frozen=True, slots=True, eq=False)
class Phrases:
    """Embeddings of what each word looks like; the picture's own is the answer of a model like CLIP."""

    text: FloatArray  # (W + 1, d) unit vectors; zero for nothing where no phrase of it is known

    def __call__(self, answer: FloatArray) -> FloatArray:
        """Raises DataError: the answer has another length."""
        if answer.shape != self.text.shape[1:]:
            raise DataError(
                f"the model answers a picture with {_shape(answer)} numbers and the phrases have {self.text.shape[1]}; "
                "embed the phrases with the text encoder of this very model"
            )
        cosine = self.text @ answer / max(float(np.linalg.norm(answer)), 1e-12)
        return softmax(np.where(self.text.any(axis=1), CLIP_SCALE * cosine, -np.inf))


@dataclass(frozen=True, slots=True, eq=False)
class Labels:
    """Which words each label of a classifier or detector stands for."""

    share: FloatArray  # (K, W + 1), each label's shares in what it stands for; they sum to 1

    def __call__(self, answer: FloatArray) -> FloatArray:
        """Raises DataError: the answer has another shape, or scores that are no probabilities."""
        k = len(self.share)
        if answer.shape == (k,):
            is_share = bool((answer >= 0).all()) and abs(float(answer.sum()) - 1) < 1e-2
            return (answer if is_share else softmax(answer)) @ self.share
        if answer.ndim == 2 and BOX + k in answer.shape:
            scores = answer[BOX:] if answer.shape[0] == BOX + k else answer[:, BOX:].T
            return self._of_things(scores.max(axis=1, initial=0.0))
        raise DataError(
            f"the model answers a picture with {_shape(answer)} numbers, which do not fit {k} labels; a classifier has "
            f"one number a label, a detector {BOX} and one a label for each box"
        )

    def _of_things(self, seen: FloatArray) -> FloatArray:
        """Of the probabilities (K,) that each thing is in view. At least one of a room's things speaks for the room."""
        if seen.min(initial=0.0) < 0 or seen.max(initial=0.0) > 1 + 1e-3:
            raise DataError("the model's scores are not between 0 and 1; export it with its sigmoid")
        speaks = 1 - np.exp(np.log1p(-np.minimum(seen, 1 - 1e-9)) @ self.share[:, :-1])
        speaks /= max(1.0, float(speaks.sum()))  # things of two rooms in one view
        return np.append(speaks, max(0.0, 1 - float(speaks.sum())))


def phrases_look(path: Path, names: Path | None, words: RoomWords) -> tuple[Look, RoomWords]:
    """How to read a model like CLIP, and the words it votes for: those with an embedded phrase.

    Raises DataError, naming the file.
    """
    known, vectors = _read_embeddings(path, names)
    if vectors.ndim != 2 or len(vectors) != len(known) or not vectors.shape[1]:
        raise DataError(f"{path} has {len(known)} names and embeddings of {_shape(vectors)}; give one row a name")
    lengths = np.linalg.norm(vectors, axis=1)
    if not np.isfinite(lengths).all() or not lengths.all():
        raise DataError(f"{path} has an embedding without direction; embed its phrases again")
    unit = vectors / lengths[:, None]
    words = _known(known, words, path)
    text = np.zeros((len(words.rooms) + 1, unit.shape[1]))
    for vector, columns in zip(unit, _columns(known, words), strict=True):
        text[columns] += vector  # the mean direction of all phrases of a word (Radford et al., 3.1.4)
    lengths = np.linalg.norm(text, axis=1, keepdims=True)
    text = np.divide(text, lengths, out=np.zeros_like(text), where=lengths > 0)
    return Phrases(text), words


def labels_look(path: Path, words: RoomWords) -> tuple[Look, RoomWords]:
    """How to read a classifier or detector, and the words it votes for: those with a label. Raises DataError."""
    labels = _read_list(path)
    words = _known(labels, words, path)
    share = np.zeros((len(labels), len(words.rooms) + 1))
    for row, columns in zip(share, _columns(labels, words), strict=True):
        row[columns or [-1]] = 1 / max(len(columns), 1)
    return Labels(share), words


def softmax(x: FloatArray) -> FloatArray:
    """Along the last axis."""
    e = np.exp(x - x.max(axis=-1, keepdims=True))
    return np.asarray(e / e.sum(axis=-1, keepdims=True))


def _columns(labels: Sequence[str], words: RoomWords) -> list[list[int]]:
    """For each label the numbers of the words that it stands for; the number after the last is nothing's."""
    looks = [(word.name, *word.looks_like) for word in words.rooms] + [words.nothing.looks_like]
    stands: dict[str, list[int]] = {}
    for n, phrases in enumerate(looks):
        for phrase in {p.casefold() for p in phrases}:
            stands.setdefault(phrase, []).append(n)
    return [stands.get(label.casefold(), []) for label in labels]


def _known(labels: Sequence[str], words: RoomWords, path: Path) -> RoomWords:
    """The words that some label stands for: of the others the model can say nothing. Raises DataError: of all."""
    known = {column for columns in _columns(labels, words) for column in columns}
    rooms = tuple(word for n, word in enumerate(words.rooms) if n in known)
    if not rooms:
        raise DataError(
            f"{path} has nothing that a room word looks like; edit looks_like in a copy of the list (--words)"
        )
    return RoomWords(rooms, words.nothing)


def _read_list(path: Path) -> list[str]:
    """Labels, one a line. Raises DataError."""
    try:
        lines = read_text(path, MAX_LIST_BYTES).removeprefix("\ufeff").splitlines()  # some editors begin with it
    except OSError as exc:
        raise DataError(f"{path} cannot be read ({exc.strerror}); give a text file with one label a line") from exc
    except UnicodeDecodeError as exc:
        raise DataError(f"{path} is no text; give a text file with one label a line") from exc
    while lines and not lines[-1].strip():
        del lines[-1]
    return _checked([line.strip() for line in lines], path)


def _checked(labels: list[str], path: Path) -> list[str]:
    if not 0 < len(labels) <= MAX_LABELS:
        raise DataError(f"{path} has {len(labels)} labels; give 1 to {MAX_LABELS}, one a line")
    for number, label in enumerate(labels, 1):
        if not 0 < len(label) <= MAX_PHRASE or not is_printable(label):
            raise DataError(f"{path}: label {number} needs 1 to {MAX_PHRASE} characters that can be shown")
    return labels


def _read_embeddings(path: Path, names: Path | None) -> tuple[list[str], FloatArray]:
    """Names and embeddings of phrases: arrays `names` and `embeddings` of an .npz, or an .npy with names beside it."""
    if path.suffix.lower() == ".npy" and names is None:
        raise DataError(f"{path} has no names; give them with --labels, one a line")
    try:
        with open_file(path) as file:
            if file.seek(0, os.SEEK_END) > MAX_EMBEDDING_BYTES:
                raise Refused(f"it has more than {MAX_EMBEDDING_BYTES / 1e6:.0f} MB")
            if path.suffix.lower() == ".npy":
                array, written = read_array(file), None
            else:
                with open_arrays(file) as arrays:
                    with arrays.open("embeddings") as (header, _):
                        if header.num_bytes > MAX_EMBEDDING_BYTES:  # packed they may be small
                            raise Refused(f"its embeddings have more than {MAX_EMBEDDING_BYTES / 1e6:.0f} MB")
                    array = arrays.read("embeddings")
                    written = arrays.read("names") if names is None else None
    except UNREADABLE as exc:
        what = exc.strerror if isinstance(exc, OSError) and exc.strerror else "it is damaged, or another kind of file"
        raise DataError(f"{path} cannot be read ({what}); give an .npz with arrays `names` and `embeddings`") from exc
    if array.ndim == 2 and array.shape[1] > MAX_DIMENSIONS:
        raise DataError(f"{path}: an embedding has {array.shape[1]} numbers; at most {MAX_DIMENSIONS} are read")
    if array.dtype.kind != "f":
        raise DataError(f"{path}: the embeddings are no floating-point numbers")
    return (_read_list(names) if names is not None else _checked(_texts(written, path), path)), array.astype(np.float64)


def _texts(names: npt.NDArray[Any] | None, path: Path) -> list[str]:
    if names is None or names.dtype.kind != "U" or names.ndim != 1:
        raise DataError(f"{path}: `names` is no row of texts; write it as numpy.array([...]) of str")
    try:
        return [str(name) for name in names]
    except (ValueError, SystemError) as exc:  # a number beyond the last character: some interpreters raise either
        raise DataError(f"{path}: `names` holds what is no character; write it as numpy.array([...]) of str") from exc


def _shape(array: npt.NDArray[Any]) -> str:
    return " x ".join(map(str, array.shape))
