"""Printed words in pictures, read by rapidocr: the only module that knows it."""

from __future__ import annotations

import contextlib
import importlib.util
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from shared.geometry import FloatArray
from shared.text import MAX_EXPLANATION, printable
from station.model.frames import ImageArray

# Smaller pictures are enlarged: above a camera's own size that costs twice as much, and reads no more.
LEAST_SIDE_PX = 480
MIN_SCORE = 0.9  # the best false glyph of nearby plates was at 0.71; of small print a fifth is misread at this


@dataclass(frozen=True, slots=True, eq=False)
class PrintedLine:
    """One line of text in one picture."""

    text: str
    score: float  # 0..1 of the reader
    corners_px: FloatArray  # (4, 2) top left, top right, bottom right, bottom left as one reads


def can_read_print() -> bool:
    """Whether the extra `ocr` is installed."""
    return all(importlib.util.find_spec(name) is not None for name in ("rapidocr", "onnxruntime"))


class CannotRead(Exception):
    """The extra is installed and does not work here; says why."""


@contextlib.contextmanager
def _as_cannot_read() -> Iterator[None]:
    try:
        yield
    except Exception as exc:  # an extra: what it cannot load or run, whatever it raises, is no reason for an end
        raise CannotRead(printable(f"{type(exc).__name__}: {exc}")[:MAX_EXPLANATION]) from exc


class PrintReader:
    """Reads lines of text. 0.2 s of one core a picture of 640 x 480, and half a second more for the first."""

    def __init__(self) -> None:
        """The models lie in the package, and are loaded with the first picture. Raises CannotRead."""
        with _as_cannot_read():
            from rapidocr import RapidOCR

            self._read = RapidOCR(
                params={
                    "Global.log_level": "critical",  # it warns of every picture without text
                    "Global.use_cls": False,  # no text hangs upside down
                    "Det.limit_side_len": LEAST_SIDE_PX,
                    "EngineConfig.onnxruntime.intra_op_num_threads": 1,  # jobs have one core
                    "EngineConfig.onnxruntime.inter_op_num_threads": 1,
                }
            )

    def __call__(self, bgr: ImageArray) -> list[PrintedLine]:
        """What is surely read in a picture (H, W, 3). Raises CannotRead."""
        with _as_cannot_read():
            found = self._read(bgr, text_score=MIN_SCORE)
        if found.boxes is None or found.txts is None or found.scores is None:
            return []
        return [
            PrintedLine(" ".join(text.split()), float(score), np.asarray(corners, dtype=np.float64))
            for corners, text, score in zip(found.boxes, found.txts, found.scores, strict=True)
        ]
